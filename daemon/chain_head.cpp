#include "chain_head.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>

#include "calib/file.hpp"
#include "calib/json_integer.hpp"
#include "sync_folder.hpp"

namespace calib {
namespace {

using nlohmann::json;

constexpr std::string_view purpose = "calibd chain head";
constexpr std::uint64_t largest_file = 64 * 1024;

std::filesystem::path file_in(const std::filesystem::path& folder) { return folder / "chain-head.json"; }

json to_json(const ChainHead& head) {
  return {{"schema", 1},
          {"sequence", head.sequence},
          {"sha256", head.sha256},
          {"missing", head.missing ? json(*head.missing) : json()}};
}

/// Whether all of `bytes` is on the disk.
bool write_durably(const std::filesystem::path& file, std::string_view bytes) {
  const int fd = ::open(file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0640);
  if (fd < 0) return false;
  const bool written =
      ::write(fd, bytes.data(), bytes.size()) == static_cast<ssize_t>(bytes.size()) && ::fsync(fd) == 0;
  return ::close(fd) == 0 && written;
}

}  // namespace

Result<std::optional<ChainHead>> read_chain_head(const std::filesystem::path& folder, const SigningKey* key) {
  const auto file = file_in(folder);
  const auto text = read_regular_file(file, largest_file);
  if (!text && text.error().code == ErrorCode::file_not_found) return std::optional<ChainHead>{};
  const auto refuse = [&](const std::string& what) {
    return fail(ErrorCode::malformed_head, file.string() + " " + what);
  };
  if (!text) return fail(ErrorCode::malformed_head, text.error().context);
  try {
    json object = json::parse(*text);
    const std::string mac = object.at("mac").get<std::string>(), next_mac = object.value("next_mac", "");
    object.erase("mac");
    object.erase("next_mac");
    const std::string content = object.dump();
    if (key != nullptr && !key->is_mac(purpose, content, mac) && !key->is_mac(purpose, content, next_mac))
      return refuse("was not written with this signing key");
    ChainHead head{integer_from<std::uint64_t>(object.at("sequence")), object.at("sha256").get<std::string>(), {}};
    if (const json& missing = object.at("missing"); !missing.is_null()) head.missing = missing.get<std::string>();
    return std::optional(std::move(head));
  } catch (const std::exception&) {  // whose words may quote the file
    return refuse("is not what calibd writes there");
  }
}

Result<void> write_chain_head(const std::filesystem::path& folder, const ChainHead& head, const SigningKey& key,
                              const SigningKey* next) {
  json object = to_json(head);
  const std::string content = object.dump();
  object["mac"] = key.mac(purpose, content);
  if (next != nullptr) object["next_mac"] = next->mac(purpose, content);
  const auto file = file_in(folder);
  const std::string beside = file.string() + ".new";
  if (write_durably(beside, object.dump() + '\n') && ::rename(beside.c_str(), file.c_str()) == 0 && sync_folder(folder))
    return {};
  return fail(ErrorCode::store_failed, file.string() + " cannot be written: " + std::strerror(errno));
}

}  // namespace calib
