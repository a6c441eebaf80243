#include "calib/signature.hpp"

#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <new>
#include <optional>
#include <span>
#include <utility>
#include <vector>

namespace calib {
namespace {

// The binary layouts under minisign's base64 (https://jedisct1.github.io/minisign/, "signature format").
constexpr std::array<std::uint8_t, 2> key_algorithm{'E', 'd'};
constexpr std::array<std::uint8_t, 2> signature_algorithm{'E', 'D'};
constexpr std::array<std::uint8_t, 2> no_key_derivation{0, 0};
constexpr std::array<std::uint8_t, 2> checksum_algorithm{'B', '2'};
constexpr std::size_t secret_key_bytes = 158, public_key_bytes = 42, signature_bytes = 74;
constexpr std::size_t secret_id_at = 54, secret_key_at = 62;
constexpr std::size_t largest_key_file = 4096;

constexpr std::string_view untrusted_prefix = "untrusted comment: ";
constexpr std::string_view trusted_prefix = "trusted comment: ";

/// In pages of its own, between two that nobody can read. They are locked, and left out of core files; where the limit
/// of locked memory is reached, the first is not done.
std::uint8_t* locked_bytes(std::size_t size) {
  auto* const bytes = static_cast<std::uint8_t*>(sodium_malloc(size));
  if (bytes == nullptr) throw std::bad_alloc();
  std::fill_n(bytes, size, std::uint8_t{0});
  return bytes;
}

/// Bytes that are locked while they are there, and wiped when they go.
struct Secret {
  std::span<std::uint8_t> bytes;
  explicit Secret(std::size_t size) : bytes(locked_bytes(size), size) {}
  Secret(Secret&& other) noexcept : bytes(std::exchange(other.bytes, {})) {}
  Secret& operator=(Secret&&) = delete;
  ~Secret() { sodium_free(bytes.data()); }
  [[nodiscard]] std::string_view text() const { return {reinterpret_cast<const char*>(bytes.data()), bytes.size()}; }
};

struct FileDescriptor {
  int number;
  explicit FileDescriptor(int descriptor) : number(descriptor) {}
  FileDescriptor(FileDescriptor&& other) noexcept : number(std::exchange(other.number, -1)) {}
  FileDescriptor& operator=(FileDescriptor&&) = delete;
  ~FileDescriptor() {
    if (number >= 0) ::close(number);
  }
};

/// libsodium must choose its implementation before it is used; there is no way on without it.
void require_sodium() {
  static const bool ready = sodium_init() >= 0;
  if (!ready) std::abort();
}

const unsigned char* as_bytes(std::string_view text) { return reinterpret_cast<const unsigned char*>(text.data()); }

std::string to_base64(const std::uint8_t* bytes, std::size_t size) {
  std::string text(sodium_base64_ENCODED_LEN(size, sodium_base64_VARIANT_ORIGINAL), '\0');
  sodium_bin2base64(text.data(), text.size(), bytes, size, sodium_base64_VARIANT_ORIGINAL);
  text.pop_back();  // libsodium counts the terminating zero
  return text;
}

/// True when `text` is the base64 of exactly `size` bytes, which are then in `out`. Only the one text that
/// they are written as: libsodium 1.0.18 also reads '+' and '/' with their top bit set.
bool from_base64(std::string_view text, std::uint8_t* out, std::size_t size) {
  std::size_t length = 0;
  const char* end = nullptr;
  return sodium_base642bin(out, size, text.data(), text.size(), nullptr, &length, &end,
                           sodium_base64_VARIANT_ORIGINAL) == 0 &&
         length == size && end == text.data() + text.size() &&
         std::ranges::all_of(text, [](char c) { return static_cast<unsigned char>(c) < 0x80; });
}

/// Without their ends, which may have a carriage return as minisign accepts it: files come through mail and Windows.
std::vector<std::string_view> lines_of(std::string_view text) {
  std::vector<std::string_view> lines;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    lines.push_back(text.substr(0, end));
    if (lines.back().ends_with('\r')) lines.back().remove_suffix(1);
    text.remove_prefix(std::min(end + 1, text.size()));
  }
  return lines;
}

std::string id_text(const std::array<std::uint8_t, 8>& id) {
  constexpr char hex[] = "0123456789ABCDEF";
  std::string text;
  for (auto byte = id.rbegin(); byte != id.rend(); ++byte) text += {hex[*byte >> 4], hex[*byte & 15]};
  return text;
}

Error os_error(ErrorCode code, const std::filesystem::path& file) {
  return {code, file.string() + ": " + std::strerror(errno)};
}

/// The content of a small file, read without a buffer that nobody wipes. `require_private` refuses a file
/// that everybody may read or write: group bits may be set, because systemd's credentials carry the mask of
/// an access list there.
Result<Secret> read_key_file(int file, const std::string& name, bool require_private) {
  struct stat about {};
  if (::fstat(file, &about) != 0) return tl::unexpected(os_error(ErrorCode::bad_key, name));
  if (!S_ISREG(about.st_mode) || about.st_size <= 0 || about.st_size > static_cast<off_t>(largest_key_file))
    return fail(ErrorCode::bad_key, name + " is not a minisign key file");
  if (require_private && (about.st_mode & S_IRWXO) != 0)
    return fail(ErrorCode::key_permissions, name + " is open to every user; run: chmod 600 " + name);
  Result<Secret> content(tl::in_place, static_cast<std::size_t>(about.st_size));
  const ssize_t length = ::pread(file, content->bytes.data(), content->bytes.size(), 0);
  if (length != about.st_size) return fail(ErrorCode::bad_key, name + " could not be read in full");
  return content;
}

Result<FileDescriptor> open_key_file(const std::filesystem::path& file) {
  const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (descriptor >= 0) return FileDescriptor{descriptor};
  return tl::unexpected(os_error(errno == ENOENT ? ErrorCode::key_not_found : ErrorCode::bad_key, file));
}

/// The base64 line below the comment of a minisign key file.
std::optional<std::string_view> key_line(std::string_view content) {
  const auto lines = lines_of(content);
  if (lines.size() != 2 || !lines[0].starts_with(untrusted_prefix)) return std::nullopt;
  return lines[1];
}

Result<void> write_new_file(const std::filesystem::path& file, std::string_view content, mode_t mode) {
  const FileDescriptor descriptor{::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, mode)};
  if (descriptor.number < 0 && errno == EEXIST)
    return fail(ErrorCode::key_exists, file.string() + " exists and is kept; choose another name or move it away");
  // fchmod: the creation mask must not take the public key from those who verify.
  if (descriptor.number < 0 || ::fchmod(descriptor.number, mode) != 0 ||
      ::write(descriptor.number, content.data(), content.size()) != static_cast<ssize_t>(content.size()) ||
      ::fsync(descriptor.number) != 0)
    return tl::unexpected(os_error(ErrorCode::key_not_written, file));
  return {};
}

}  // namespace

std::string PublicKey::id_text() const { return calib::id_text(id); }

std::string PublicKey::text() const {
  std::array<std::uint8_t, public_key_bytes> raw;
  const auto after_algorithm = std::copy(key_algorithm.begin(), key_algorithm.end(), raw.begin());
  std::copy(key.begin(), key.end(), std::copy(id.begin(), id.end(), after_algorithm));
  return to_base64(raw.data(), raw.size());
}

Result<PublicKey> parse_public_key(std::string_view text) {
  require_sodium();
  std::array<std::uint8_t, public_key_bytes> raw;
  if (!from_base64(text, raw.data(), raw.size()) ||
      !std::equal(key_algorithm.begin(), key_algorithm.end(), raw.begin()))
    return fail(ErrorCode::bad_key, "it is not a minisign public key");
  PublicKey key;
  std::copy_n(raw.begin() + key_algorithm.size(), key.id.size(), key.id.begin());
  std::copy_n(raw.begin() + key_algorithm.size() + key.id.size(), key.key.size(), key.key.begin());
  return key;
}

void SigningKey::Wipe::operator()(std::uint8_t* bytes) const { sodium_free(bytes); }

SigningKey::SigningKey() : secret_(locked_bytes(crypto_sign_SECRETKEYBYTES)) {}

SigningKey SigningKey::generate() {
  require_sodium();
  SigningKey key;
  std::array<std::uint8_t, 32> public_half;
  randombytes_buf(key.id_.data(), key.id_.size());
  crypto_sign_keypair(public_half.data(), key.secret_.get());
  return key;
}

Result<SigningKey> SigningKey::load(const std::filesystem::path& file) {
  const auto opened = open_key_file(file);
  if (!opened) return propagate(opened);
  return load(opened->number, file.string());
}

Result<SigningKey> SigningKey::load(int file, const std::string& name) {
  require_sodium();
  const auto content = read_key_file(file, name, true);
  if (!content) return propagate(content);
  const auto line = key_line(content->text());
  Secret raw(secret_key_bytes);
  if (!line || !from_base64(*line, raw.bytes.data(), raw.bytes.size()) ||
      !std::equal(key_algorithm.begin(), key_algorithm.end(), raw.bytes.begin()))
    return fail(ErrorCode::bad_key, name + " is not a minisign secret key");
  if (!std::equal(no_key_derivation.begin(), no_key_derivation.end(), raw.bytes.begin() + 2))
    return fail(ErrorCode::bad_key, name +
                                        " is protected by a password, which a daemon cannot type; make one "
                                        "with `calibctl keygen` or `minisign -G -W`");
  SigningKey key;
  std::copy_n(raw.bytes.begin() + secret_id_at, key.id_.size(), key.id_.begin());
  std::copy_n(raw.bytes.begin() + secret_key_at, crypto_sign_SECRETKEYBYTES, key.secret_.get());

  // Without a password minisign writes no checksum; but the secret key holds its public half, which must fit.
  std::array<std::uint8_t, 32> public_half;
  Secret derived(crypto_sign_SECRETKEYBYTES);
  crypto_sign_seed_keypair(public_half.data(), derived.bytes.data(), key.secret_.get());
  if (sodium_memcmp(derived.bytes.data(), key.secret_.get(), crypto_sign_SECRETKEYBYTES) != 0)
    return fail(ErrorCode::bad_key, name + " is damaged: its two halves do not belong together");
  return key;
}

Result<void> SigningKey::save(const std::filesystem::path& file) const {
  Secret raw(secret_key_bytes);
  std::copy(key_algorithm.begin(), key_algorithm.end(), raw.bytes.begin());
  std::copy(checksum_algorithm.begin(), checksum_algorithm.end(), raw.bytes.begin() + 4);
  std::copy(id_.begin(), id_.end(), raw.bytes.begin() + secret_id_at);
  std::copy_n(secret_.get(), crypto_sign_SECRETKEYBYTES, raw.bytes.begin() + secret_key_at);
  std::string secret_text = to_base64(raw.bytes.data(), raw.bytes.size());
  std::string secret_file;
  secret_file.reserve(512);  // growing would leave copies of the key behind
  secret_file.append(untrusted_prefix).append("calibd signing key, keep it secret\n").append(secret_text) += '\n';

  const PublicKey half = public_key();
  const std::string public_file =
      std::string(untrusted_prefix) + "minisign public key " + half.id_text() + '\n' + half.text() + '\n';

  std::filesystem::path public_path = file;
  public_path.replace_extension(".pub");
  Result<void> written =
      public_path == file ? fail(ErrorCode::bad_name, file.string() + " is the name of the public key; choose another")
                          : write_new_file(file, secret_file, 0600);
  sodium_memzero(secret_text.data(), secret_text.size());
  sodium_memzero(secret_file.data(), secret_file.size());
  if (!written) return written;
  written = write_new_file(public_path, public_file, 0644);
  if (!written) ::unlink(file.c_str());  // half a pair is of no use and would block the next try
  return written;
}

PublicKey SigningKey::public_key() const {
  PublicKey half{.id = id_};
  if (secret_) crypto_sign_ed25519_sk_to_pk(half.key.data(), secret_.get());
  return half;
}

std::string SigningKey::sign(std::string_view bytes, std::string_view trusted_comment) const {
  assert(trusted_comment.find_first_of("\r\n") == std::string_view::npos);
  std::array<std::uint8_t, crypto_generichash_BYTES_MAX> hash;
  crypto_generichash(hash.data(), hash.size(), as_bytes(bytes), bytes.size(), nullptr, 0);
  std::array<std::uint8_t, signature_bytes> block;
  const auto after_algorithm = std::copy(signature_algorithm.begin(), signature_algorithm.end(), block.begin());
  std::uint8_t* const signature = &*std::copy(id_.begin(), id_.end(), after_algorithm);
  crypto_sign_detached(signature, nullptr, hash.data(), hash.size(), secret_.get());

  std::string sealed(reinterpret_cast<const char*>(signature), crypto_sign_BYTES);
  sealed += trusted_comment;
  std::array<std::uint8_t, crypto_sign_BYTES> global;
  crypto_sign_detached(global.data(), nullptr, as_bytes(sealed), sealed.size(), secret_.get());

  std::string file(untrusted_prefix);
  file.append("signature from calibd, key ").append(id_text(id_)) += '\n';
  file.append(to_base64(block.data(), block.size())) += '\n';
  file.append(trusted_prefix).append(trusted_comment) += '\n';
  file.append(to_base64(global.data(), global.size())) += '\n';
  return file;
}

std::string SigningKey::mac(std::string_view purpose, std::string_view bytes) const {
  Secret derived(crypto_generichash_KEYBYTES);
  // The first half of an Ed25519 secret key is its seed.
  crypto_generichash(derived.bytes.data(), derived.bytes.size(), as_bytes(purpose), purpose.size(), secret_.get(),
                     crypto_sign_SEEDBYTES);
  std::array<std::uint8_t, crypto_generichash_BYTES> code;
  crypto_generichash(code.data(), code.size(), as_bytes(bytes), bytes.size(), derived.bytes.data(),
                     derived.bytes.size());
  std::string text(2 * code.size() + 1, '\0');
  sodium_bin2hex(text.data(), text.size(), code.data(), code.size());
  text.pop_back();
  return text;
}

bool SigningKey::is_mac(std::string_view purpose, std::string_view bytes, std::string_view mac) const {
  const std::string expected = this->mac(purpose, bytes);
  return mac.size() == expected.size() && sodium_memcmp(mac.data(), expected.data(), expected.size()) == 0;
}

Result<PublicKey> load_public_key(const std::filesystem::path& file) {
  require_sodium();
  const auto opened = open_key_file(file);
  if (!opened) return propagate(opened);
  const auto content = read_key_file(opened->number, file.string(), false);
  if (!content) return propagate(content);
  const auto line = key_line(content->text());
  if (auto key = parse_public_key(line.value_or(""))) return key;
  return fail(ErrorCode::bad_key, file.string() + " is not a minisign public key");
}

Result<void> verify_signature(std::string_view bytes, std::string_view signature_file, const PublicKey& key) {
  require_sodium();
  const auto lines = lines_of(signature_file);
  std::array<std::uint8_t, signature_bytes> block;
  std::array<std::uint8_t, crypto_sign_BYTES> global;
  if (lines.size() != 4 || !lines[0].starts_with(untrusted_prefix) || !lines[2].starts_with(trusted_prefix) ||
      !from_base64(lines[1], block.data(), block.size()) || !from_base64(lines[3], global.data(), global.size()) ||
      !std::equal(signature_algorithm.begin(), signature_algorithm.end(), block.begin()))
    return fail(ErrorCode::bad_signature, "the signature is not a minisign signature file of a hashed (ED) signature");

  std::array<std::uint8_t, 8> signer;
  std::copy_n(block.begin() + signature_algorithm.size(), signer.size(), signer.begin());
  if (signer != key.id)
    return fail(ErrorCode::wrong_key, "signed by key " + id_text(signer) + ", you have " + key.id_text());

  const std::uint8_t* const signature = block.data() + signature_algorithm.size() + signer.size();
  std::array<std::uint8_t, crypto_generichash_BYTES_MAX> hash;
  crypto_generichash(hash.data(), hash.size(), as_bytes(bytes), bytes.size(), nullptr, 0);
  if (crypto_sign_verify_detached(signature, hash.data(), hash.size(), key.key.data()) != 0)
    return fail(ErrorCode::bad_signature, "key " + key.id_text() + " did not sign these bytes");

  std::string sealed(reinterpret_cast<const char*>(signature), crypto_sign_BYTES);
  sealed += lines[2].substr(trusted_prefix.size());
  if (crypto_sign_verify_detached(global.data(), as_bytes(sealed), sealed.size(), key.key.data()) != 0)
    return fail(ErrorCode::bad_signature, "the trusted comment is not the one that was signed");
  return {};
}

}  // namespace calib
