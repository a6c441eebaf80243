#pragma once

#include <sqlite3.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <random>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace calib::test {

/// What SQLite asks of the disk, in order.
struct DiskOperation {
  enum class Kind { write, truncate, sync, remove } kind = Kind::write;
  std::string file;          // its name, without the folder
  std::int64_t offset = 0;   // of a write; the new length of a truncation
  std::string bytes{};       // of a write
  bool with_folder = false;  // of a sync or a removal: the folder was synced, too
};

/// While it lives, it is SQLite's default file system: it does what that of the system does, and notes what could be
/// lost by a power cut. Files for shared memory are not noted: they do not survive one. Only one at a time.
class RecordingVfs {
 public:
  /// `before_each` is called before an operation.
  explicit RecordingVfs(std::function<void()> before_each)
      : before_each_(std::move(before_each)), system_(sqlite3_vfs_find(nullptr)), own_(*system_) {
    current() = this;
    own_.zName = "recording";
    own_.szOsFile = static_cast<int>(sizeof(File)) + system_->szOsFile;
    own_.xOpen = open;
    own_.xDelete = remove;
    sqlite3_vfs_register(&own_, /*makeDflt=*/1);
  }
  ~RecordingVfs() {
    sqlite3_vfs_unregister(&own_);
    sqlite3_vfs_register(system_, 1);
    current() = nullptr;
  }
  RecordingVfs(const RecordingVfs&) = delete;
  RecordingVfs& operator=(const RecordingVfs&) = delete;

  [[nodiscard]] const std::vector<DiskOperation>& operations() const { return operations_; }
  /// After so many more writes, or syncs, each one fails with this code of SQLite's, until `heal`.
  void fail_after(int operations, int code) {
    until_failure_ = operations;
    failure_ = code;
  }
  void heal() { failure_ = SQLITE_OK; }

 private:
  struct File {
    sqlite3_file base;
    char name[64];
    bool syncs_folder;  // the system's does so with the first sync of a log that may be new
    [[nodiscard]] sqlite3_file* system() { return reinterpret_cast<sqlite3_file*>(this + 1); }
  };
  static File& of(sqlite3_file* file) { return *reinterpret_cast<File*>(file); }
  static RecordingVfs*& current() {
    static RecordingVfs* vfs = nullptr;
    return vfs;
  }
  static void note(DiskOperation operation) {
    current()->before_each_();
    current()->operations_.push_back(std::move(operation));
  }

  static int failure_of(DiskOperation::Kind kind) {
    RecordingVfs& vfs = *current();
    const bool concerns = (kind == DiskOperation::Kind::sync) == (vfs.failure_ == SQLITE_IOERR_FSYNC);
    return vfs.failure_ == SQLITE_OK || !concerns || vfs.until_failure_-- > 0 ? SQLITE_OK : vfs.failure_;
  }

  static int open(sqlite3_vfs*, sqlite3_filename name, sqlite3_file* file, int flags, int* out_flags) {
    File& own = of(file);
    own.base.pMethods = nullptr;
    const std::string base = name == nullptr ? "" : std::filesystem::path(name).filename().string();
    if (base.size() >= sizeof own.name) return SQLITE_CANTOPEN;
    std::memcpy(own.name, base.c_str(), base.size() + 1);
    own.syncs_folder = (flags & SQLITE_OPEN_CREATE) != 0 && (flags & (SQLITE_OPEN_WAL | SQLITE_OPEN_MAIN_JOURNAL)) != 0;
    sqlite3_vfs* const system = current()->system_;
    const int code = system->xOpen(system, name, own.system(), flags, out_flags);
    if (own.system()->pMethods != nullptr) own.base.pMethods = &methods();
    return code;
  }
  static int remove(sqlite3_vfs*, const char* name, int sync_folder) {
    note({.kind = DiskOperation::Kind::remove,
          .file = std::filesystem::path(name).filename().string(),
          .with_folder = sync_folder != 0});
    sqlite3_vfs* const system = current()->system_;
    return system->xDelete(system, name, sync_folder);
  }
  static const sqlite3_io_methods& methods() {
    static const sqlite3_io_methods all = [] {
      sqlite3_io_methods io{};
      io.iVersion = 3;
      io.xClose = [](sqlite3_file* file) { return of(file).system()->pMethods->xClose(of(file).system()); };
      io.xRead = [](sqlite3_file* file, void* to, int size, sqlite3_int64 offset) {
        return of(file).system()->pMethods->xRead(of(file).system(), to, size, offset);
      };
      io.xWrite = [](sqlite3_file* file, const void* from, int size, sqlite3_int64 offset) {
        if (const int failure = failure_of(DiskOperation::Kind::write); failure != SQLITE_OK) return failure;
        note({.kind = DiskOperation::Kind::write,
              .file = of(file).name,
              .offset = offset,
              .bytes = std::string(static_cast<const char*>(from), static_cast<std::size_t>(size))});
        return of(file).system()->pMethods->xWrite(of(file).system(), from, size, offset);
      };
      io.xTruncate = [](sqlite3_file* file, sqlite3_int64 size) {
        note({.kind = DiskOperation::Kind::truncate, .file = of(file).name, .offset = size});
        return of(file).system()->pMethods->xTruncate(of(file).system(), size);
      };
      io.xSync = [](sqlite3_file* file, int flags) {
        if (const int failure = failure_of(DiskOperation::Kind::sync); failure != SQLITE_OK) return failure;
        note({.kind = DiskOperation::Kind::sync,
              .file = of(file).name,
              .with_folder = std::exchange(of(file).syncs_folder, false)});
        return of(file).system()->pMethods->xSync(of(file).system(), flags);
      };
      io.xFileSize = [](sqlite3_file* file, sqlite3_int64* size) {
        return of(file).system()->pMethods->xFileSize(of(file).system(), size);
      };
      io.xLock = [](sqlite3_file* file, int lock) {
        return of(file).system()->pMethods->xLock(of(file).system(), lock);
      };
      io.xUnlock = [](sqlite3_file* file, int lock) {
        return of(file).system()->pMethods->xUnlock(of(file).system(), lock);
      };
      io.xCheckReservedLock = [](sqlite3_file* file, int* reserved) {
        return of(file).system()->pMethods->xCheckReservedLock(of(file).system(), reserved);
      };
      io.xFileControl = [](sqlite3_file* file, int what, void* argument) {
        return of(file).system()->pMethods->xFileControl(of(file).system(), what, argument);
      };
      io.xSectorSize = [](sqlite3_file* file) { return of(file).system()->pMethods->xSectorSize(of(file).system()); };
      io.xDeviceCharacteristics = [](sqlite3_file* file) {
        return of(file).system()->pMethods->xDeviceCharacteristics(of(file).system());
      };
      io.xShmMap = [](sqlite3_file* file, int page, int size, int extend, void volatile** mapped) {
        return of(file).system()->pMethods->xShmMap(of(file).system(), page, size, extend, mapped);
      };
      io.xShmLock = [](sqlite3_file* file, int offset, int count, int flags) {
        return of(file).system()->pMethods->xShmLock(of(file).system(), offset, count, flags);
      };
      io.xShmBarrier = [](sqlite3_file* file) { of(file).system()->pMethods->xShmBarrier(of(file).system()); };
      io.xShmUnmap = [](sqlite3_file* file, int remove) {
        return of(file).system()->pMethods->xShmUnmap(of(file).system(), remove);
      };
      io.xFetch = [](sqlite3_file* file, sqlite3_int64 offset, int size, void** page) {
        return of(file).system()->pMethods->xFetch(of(file).system(), offset, size, page);
      };
      io.xUnfetch = [](sqlite3_file* file, sqlite3_int64 offset, void* page) {
        return of(file).system()->pMethods->xUnfetch(of(file).system(), offset, page);
      };
      return io;
    }();
    return all;
  }

  std::function<void()> before_each_;
  sqlite3_vfs* system_;
  sqlite3_vfs own_;
  std::vector<DiskOperation> operations_;
  int until_failure_ = 0, failure_ = SQLITE_OK;
};

/// A disk after a power cut: what was synced is there; of what was not, each operation has happened, or has not, or
/// (a write) only some of its sectors; in any order.
class CrashedDisk {
 public:
  /// After the first `count` operations.
  CrashedDisk(const std::vector<DiskOperation>& operations, std::size_t count, std::mt19937& random) {
    std::map<std::string, std::vector<const DiskOperation*>> pending;
    const auto settle = [this](auto& waiting, auto end) {
      for (auto each = waiting.begin(); each != end; ++each) apply(**each);
      waiting.erase(waiting.begin(), end);
    };
    for (std::size_t i = 0; i < count; ++i) {
      const DiskOperation& operation = operations[i];
      pending[operation.file].push_back(&operation);
      if (operation.kind == DiskOperation::Kind::sync) settle(pending[operation.file], pending[operation.file].end());
      if (!operation.with_folder) continue;
      for (auto& [file, waiting] : pending) {
        const auto last = std::find_if(waiting.rbegin(), waiting.rend(), [](const DiskOperation* each) {
          return each->kind == DiskOperation::Kind::remove;
        });
        settle(waiting, last.base());
      }
    }
    for (auto& [file, waiting] : pending) {
      // All or nothing now and then: between these, what happened to each is drawn by lot.
      const auto luck = random() % 4;
      if (luck >= 2) std::shuffle(waiting.begin(), waiting.end(), random);
      for (const DiskOperation* each : waiting) {
        unsynced_ = true;
        if (luck == 0 || (luck >= 2 && random() % 2 == 0)) continue;
        apply(luck == 3 && each->kind == DiskOperation::Kind::write ? torn(*each, random) : *each);
      }
    }
  }

  void put_into(const std::filesystem::path& folder) const {
    for (const auto& [name, bytes] : files_) {
      std::ofstream file(folder / name, std::ios::binary);
      file << bytes;
      if (!file.flush()) throw std::runtime_error("cannot write " + (folder / name).string());
    }
  }
  /// Whether anything was open to chance.
  [[nodiscard]] bool had_unsynced() const { return unsynced_; }

 private:
  static constexpr std::size_t sector = 512;

  /// Sectors that the disk did not get to are as they were.
  DiskOperation torn(DiskOperation write, std::mt19937& random) const {
    const auto found = files_.find(write.file);
    for (std::size_t begin = 0; begin < write.bytes.size(); begin += sector) {
      if (random() % 2 == 0) continue;
      for (std::size_t i = begin; i < std::min(begin + sector, write.bytes.size()); ++i) {
        const std::size_t at = static_cast<std::size_t>(write.offset) + i;
        write.bytes[i] = found != files_.end() && at < found->second.size() ? found->second[at] : '\0';
      }
    }
    return write;
  }
  void apply(const DiskOperation& operation) {
    if (operation.kind == DiskOperation::Kind::remove) {
      files_.erase(operation.file);
      return;
    }
    std::string& bytes = files_[operation.file];
    const auto offset = static_cast<std::size_t>(operation.offset);
    if (operation.kind == DiskOperation::Kind::truncate) bytes.resize(offset);
    if (operation.kind == DiskOperation::Kind::write) {
      bytes.resize(std::max(bytes.size(), offset + operation.bytes.size()));
      bytes.replace(offset, operation.bytes.size(), operation.bytes);
    }
  }

  std::map<std::string, std::string> files_;
  bool unsynced_ = false;
};

}  // namespace calib::test
