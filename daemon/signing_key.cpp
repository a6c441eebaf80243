#include "signing_key.hpp"

#include "calib/file.hpp"

namespace calib {
namespace {

/// The unit passes this and the path where there is no file to copy (SetCredential= in calibd.service).
constexpr std::string_view missing = "missing:";
constexpr std::uint64_t largest_path = 4096;

std::string make_with(const std::string& file) { return "make one with `calibctl keygen --out " + file + "`"; }

/// Of a key that the service manager has copied: the file that it should have been copied from, if there was none.
std::optional<std::string> missing_source(const std::filesystem::path& credential) {
  const auto text = read_regular_file(credential, largest_path);
  if (!text || !text->starts_with(missing)) return std::nullopt;
  return text->substr(missing.size());
}

}  // namespace

Result<SigningKey> load_signing_key(const Config& config) {
  auto key = SigningKey::load(config.signing_key);
  if (key) return key;
  Error& error = key.error();
  const std::string file = config.signing_key.string();
  if (config.signing_key_is_given) {
    if (error.code == ErrorCode::key_not_found)
      error.context = "signing_key: there is no " + file + "; " + make_with(file);
    else
      error.context = "signing_key: " + error.context +
                      (error.code == ErrorCode::bad_key
                           ? "; put the vehicle's key back, or move that file away and " + make_with(file)
                           : "");
    return key;
  }
  if (const auto source = missing_source(config.signing_key))
    return fail(ErrorCode::key_not_found, "there is no signing key: " + *source + " does not exist; " +
                                              make_with(*source) + ", then start calibd again");
  error.context +=
      "; it should be the copy of a signing key, which systemd makes of the file that LoadCredential= of "
      "the unit names, /etc/calibd/signing.key by default; put the vehicle's key there, or move what is "
      "there away and " +
      make_with("/etc/calibd/signing.key") + ", then start calibd again";
  return key;
}

}  // namespace calib
