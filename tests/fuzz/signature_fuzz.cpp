#include "calib/signature.hpp"

#include <sodium.h>

#include <array>

#include "fuzz/fuzz.hpp"
#include "fuzz/scratch.hpp"

namespace calib::fuzz {

const std::string message = "what is signed";

std::string base64(const Octets& bytes) {
  std::string text(sodium_base64_ENCODED_LEN(bytes.size(), sodium_base64_VARIANT_ORIGINAL), '\0');
  sodium_bin2base64(text.data(), text.size(), bytes.data(), bytes.size(), sodium_base64_VARIANT_ORIGINAL);
  text.pop_back();  // the terminating zero
  return text;
}

/// An unencrypted minisign secret key, the same one each time.
std::string secret_key_file() {
  require(sodium_init() >= 0);
  constexpr std::array<std::uint8_t, crypto_sign_SEEDBYTES> zeros{};
  std::array<std::uint8_t, crypto_sign_PUBLICKEYBYTES> public_half{};
  std::array<std::uint8_t, crypto_sign_SECRETKEYBYTES> key{};
  crypto_sign_seed_keypair(public_half.data(), key.data(), zeros.data());

  const Octets algorithm = octets("Ed"), id = octets("fuzz key");
  Octets checked = algorithm;
  checked.insert(checked.end(), id.begin(), id.end());
  checked.insert(checked.end(), key.begin(), key.end());
  std::array<std::uint8_t, 32> checksum{};
  crypto_generichash(checksum.data(), checksum.size(), checked.data(), checked.size(), nullptr, 0);

  Octets bytes = octets(std::string_view("Ed\0\0B2", 6));
  bytes.resize(54);  // salt and limits of a key derivation that is not used
  bytes.insert(bytes.end(), checked.begin() + 2, checked.end());
  bytes.insert(bytes.end(), checksum.begin(), checksum.end());
  return "untrusted comment: minisign secret key\n" + base64(bytes) + "\n";
}

std::string public_key_file(const PublicKey& key) {
  Octets bytes = octets("Ed");
  bytes.insert(bytes.end(), key.id.begin(), key.id.end());
  bytes.insert(bytes.end(), key.key.begin(), key.key.end());
  return "untrusted comment: minisign public key\n" + base64(bytes) + "\n";
}

/// Everything below the untrusted comment: there is one way to write it.
std::string_view below_comment(std::string_view file) {
  file.remove_prefix(std::min(file.find('\n'), file.size()));
  while (file.ends_with('\n')) file.remove_suffix(1);
  return file;
}

const SigningKey& signing_key() {
  static const SigningKey key = [] {
    auto loaded = SigningKey::load(scratch().write("key", secret_key_file()));
    require(loaded.has_value());
    return *std::move(loaded);
  }();
  return key;
}

enum Kind : std::uint8_t { signature_file, public_file, secret_file, kinds };

std::vector<Octets> seeds() {
  const auto seed = [](Kind kind, const std::string& content) { return Output().put(kind).with(octets(content)); };
  return {seed(signature_file, signing_key().sign(message, "timestamp:1700000000")),
          seed(public_file, public_key_file(signing_key().public_key())), seed(secret_file, secret_key_file())};
}

/// No input is signed by our key but what our key signed.
void check_signature(std::string_view file) {
  static const std::string ours = signing_key().sign(message, "timestamp:1700000000");
  const auto verified = verify_signature(message, file, signing_key().public_key());
  if (verified)
    require(below_comment(file) == below_comment(ours));
  else
    require_code(verified.error(), {calib::ErrorCode::wrong_key, calib::ErrorCode::bad_signature});
  require(!verify_signature("another message", file, signing_key().public_key()));
}

void check_public_key(std::string_view file) {
  const auto key = load_public_key(scratch().write("public", file));
  if (key)
    require(below_comment(file) == below_comment(public_key_file(*key)));
  else
    require_code(key.error(), {calib::ErrorCode::bad_key});
}

/// A key that is taken can sign.
void check_secret_key(std::string_view file) {
  const auto key = SigningKey::load(scratch().write("secret", file));
  if (!key) return require_code(key.error(), {calib::ErrorCode::bad_key});
  require(verify_signature(message, key->sign(message, "comment"), key->public_key()).has_value());
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  calib::fuzz::Input input(bytes, size);
  const auto kind = input.take<std::uint8_t>() % calib::fuzz::kinds;
  const auto content = input.rest();
  const std::string_view file = calib::fuzz::text(content);
  if (kind == calib::fuzz::signature_file) calib::fuzz::check_signature(file);
  if (kind == calib::fuzz::public_file) calib::fuzz::check_public_key(file);
  if (kind == calib::fuzz::secret_file) calib::fuzz::check_secret_key(file);
  return 0;
}
