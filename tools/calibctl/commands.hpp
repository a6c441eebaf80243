#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "calib/result.hpp"

namespace calib::ctl {

/// What a command ends with; part of the interface, see calibctl(1).
enum class Exit {
  done = 0,
  failed = 1,
  usage = 2,
  not_found = 3,  // the daemon does not run, or the thing asked for is not there
  no = 4,         // answered, and the answer is no
};

/// Where calibd's things are.
struct Places {
  std::filesystem::path socket, state_dir, public_key;
  [[nodiscard]] std::filesystem::path store() const { return state_dir / "calibd.db"; }
  /// calibd's default for `head_dir`.
  [[nodiscard]] std::filesystem::path chain_head() const {
    const auto folder = state_dir.has_filename() ? state_dir : state_dir.parent_path();
    return std::filesystem::path(folder.string() + "-head") / "chain-head.json";
  }
  [[nodiscard]] std::filesystem::path snapshot() const { return socket.parent_path() / "status.json"; }
};

/// The exit that an error's code stands for.
[[nodiscard]] Exit exit_for(const Error& error);
/// Says `error` on standard error and returns `exit_for` it.
Exit complain(const Error& error);

struct StatusOptions {
  bool json = false, watch = false, exit_code = false;
};
Exit status(const Places& places, const StatusOptions& options);

/// Records of one pair, or of all when `pair` is empty.
Exit history(const Places& places, const std::string& pair);

struct ShowOptions {
  std::optional<std::uint64_t> sequence;  // the last one when none
  bool json = false;
  std::filesystem::path export_to;  // nothing is exported when empty
};
Exit show(const Places& places, const ShowOptions& options);

/// The whole chain of the store, or `files` (exported records, in any order).
Exit verify(const Places& places, const std::vector<std::filesystem::path>& files);

Exit recalibrate(const Places& places, const std::string& pair, bool dry_run);
Exit accept(const Places& places, const std::string& pair);
Exit roll_back(const Places& places, const std::string& pair, std::optional<std::uint64_t> to);

struct DoctorOptions {
  std::string pair;  // all when empty
  bool json = false;
  std::filesystem::path overlay_dir;  // pictures stay where calibd writes them when empty
};
/// Lets calibd examine itself and its sensors.
Exit doctor(const Places& places, const DoctorOptions& options);

Exit check_config(const std::filesystem::path& file);
Exit keygen(const std::filesystem::path& file);

}  // namespace calib::ctl
