#include "evidence_file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>

#include "calib/file.hpp"
#include "calib/json_integer.hpp"
#include "sync_folder.hpp"

namespace calib {
namespace {

using nlohmann::json;

constexpr std::string_view purpose = "calibd evidence";
constexpr std::uint64_t largest_file = 16 * 1024 * 1024;
/// Of a page of memory and a block of the disk. A longer write may make the kernel count, and write, more than was
/// changed.
constexpr std::size_t block_bytes = 4096;

// MAC and length of the body on a line, the body, and what is left of longer ones that were written before.

std::filesystem::path file_of(const std::filesystem::path& folder, std::uint64_t number) {
  return folder / (number % 2 == 0 ? "evidence-0" : "evidence-1");
}

Result<Evidence> parse(const std::string& bytes, const std::filesystem::path& file, const SigningKey& key) {
  const auto refuse = [&](const char* why) { return fail(ErrorCode::malformed_state, file.string() + why); };
  const auto space = bytes.find(' '), end = bytes.find('\n');
  if (space == std::string::npos || end == std::string::npos || space > end)
    return refuse(" is not what calibd writes there");
  const auto length = std::strtoull(bytes.c_str() + space, nullptr, 10);
  const std::string_view body = std::string_view(bytes).substr(end + 1, length);
  if (!key.is_mac(purpose, body, std::string_view(bytes).substr(0, space)))
    return refuse(" was not written by calibd with this signing key, or not completely");
  try {
    const json object = json::from_cbor(body.begin(), body.end());
    Evidence evidence{.number = integer_from<std::uint64_t>(object.at("number"))};
    for (const auto& [pair, since] : object.at("pairs").get_ref<const json::object_t&>())
      evidence.pairs[pair] = {since.at("follows").get<std::string>(), since.at("state").dump()};
    return evidence;
  } catch (const std::exception&) {
    return refuse(" is not what calibd writes there");
  }
}

bool write_in_place(int fd, std::string_view bytes) {
  for (std::size_t begin = 0; begin < bytes.size(); begin += block_bytes) {
    const std::string_view block = bytes.substr(begin, block_bytes);
    const ssize_t count = ::pwrite(fd, block.data(), block.size(), static_cast<off_t>(begin));
    if (count == static_cast<ssize_t>(block.size())) continue;
    if (count >= 0) errno = ENOSPC;  // the rest of the block has no place
    return false;
  }
  return ::fdatasync(fd) == 0;
}

}  // namespace

Result<Evidence> read_evidence(const std::filesystem::path& folder, const SigningKey& key) {
  std::optional<Evidence> latest;
  std::optional<Error> failure;
  for (const std::uint64_t number : {0, 1}) {
    const auto file = file_of(folder, number);
    const auto bytes = read_regular_file(file, largest_file);
    if (!bytes && bytes.error().code == ErrorCode::file_not_found) continue;
    auto read = bytes ? parse(*bytes, file, key) : fail(ErrorCode::malformed_state, bytes.error().context);
    if (!read)
      failure = std::move(read.error());
    else if (!latest || read->number > latest->number)
      latest = std::move(*read);
  }
  if (latest) return std::move(*latest);
  if (failure) return tl::unexpected(std::move(*failure));
  return Evidence{};
}

Result<void> write_evidence(const std::filesystem::path& folder, const Evidence& evidence, const SigningKey& key) {
  json pairs = json::object();
  for (const auto& [pair, since] : evidence.pairs)
    pairs[pair] = {{"follows", since.follows}, {"state", json::parse(since.state)}};
  std::string body;
  json::to_cbor({{"number", evidence.number}, {"pairs", std::move(pairs)}}, body);
  const std::string bytes = key.mac(purpose, body) + ' ' + std::to_string(body.size()) + '\n' + body;

  const auto file = file_of(folder, evidence.number);
  if (bytes.size() > largest_file)
    return fail(ErrorCode::store_failed, file.string() + " cannot be written: it would exceed 16 MiB");
  // Opening something else than a file must not wait.
  const int fd = ::open(file.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0600);
  struct stat status = {};
  bool written = fd >= 0 && ::fstat(fd, &status) == 0;
  int error = errno;
  if (written && !S_ISREG(status.st_mode)) {
    written = false;
    error = EINVAL;
  } else if (written) {
    const bool too_long = static_cast<std::uint64_t>(status.st_size) > largest_file;  // nobody would read it
    written = (!too_long || ::ftruncate(fd, 0) == 0) && write_in_place(fd, bytes) &&
              (status.st_size != 0 || sync_folder(folder));
    error = errno;
  }
  if (fd >= 0) ::close(fd);
  if (written) return {};
  return fail(ErrorCode::store_failed, file.string() + " cannot be written: " + std::strerror(error));
}

}  // namespace calib
