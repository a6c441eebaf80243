#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "calib/result.hpp"

namespace calib {

/// Ed25519 keys and signatures in minisign's formats, so that `minisign -V` checks what calibd signs.
/// Key id: minisign's eight bytes, shown as it shows them (16 upper-case hex digits, last byte first).

struct PublicKey {
  std::array<std::uint8_t, 8> id{};
  std::array<std::uint8_t, 32> key{};
  [[nodiscard]] std::string id_text() const;
  /// One word of base64 with id and key: the second line of a public key file, and what `minisign -P` takes.
  [[nodiscard]] std::string text() const;
  friend bool operator==(const PublicKey&, const PublicKey&) = default;
};

/// Its secret half lies in a memory page of its own, which is not swapped out, not written into core files, has no
/// neighbours within reach of an overrun, and is wiped when the key is destroyed.
class SigningKey {
 public:
  [[nodiscard]] static SigningKey generate();
  /// Reads an unencrypted minisign secret key (`minisign -G -W` or `calibctl keygen`).
  /// Fails with `key_not_found`, `key_permissions` (open to every user) or `bad_key`.
  [[nodiscard]] static Result<SigningKey> load(const std::filesystem::path& file);
  /// The same of an open file, which stays open; `name` is for errors.
  [[nodiscard]] static Result<SigningKey> load(int file, const std::string& name);
  /// Writes FILE (mode 0600) and the public key beside it (FILE with .pub for its extension, mode 0644);
  /// never overwrites. Fails with `key_exists`, `bad_name` (FILE already ends in .pub) or `key_not_written`.
  [[nodiscard]] Result<void> save(const std::filesystem::path& file) const;

  [[nodiscard]] PublicKey public_key() const;
  /// A minisign signature file (pre-hashed, `ED`) over `bytes`, with a trusted comment of one line.
  [[nodiscard]] std::string sign(std::string_view bytes, std::string_view trusted_comment) const;
  /// A message authentication code over `bytes`, 64 hex digits, that only the holder of this key can make: for what its
  /// writer alone reads back. Keyed BLAKE2b with a key derived for `purpose`, so that codes of one purpose are worth
  /// nothing for another.
  [[nodiscard]] std::string mac(std::string_view purpose, std::string_view bytes) const;
  [[nodiscard]] bool is_mac(std::string_view purpose, std::string_view bytes, std::string_view mac) const;

 private:
  /// Frees memory that libsodium has locked.
  struct Wipe {
    void operator()(std::uint8_t* bytes) const;
  };

  SigningKey();
  std::array<std::uint8_t, 8> id_{};
  std::unique_ptr<std::uint8_t[], Wipe> secret_;
};

/// Of `PublicKey::text`. Fails with `bad_key`.
[[nodiscard]] Result<PublicKey> parse_public_key(std::string_view text);

/// Reads a minisign public key file. Fails with `key_not_found` or `bad_key`.
[[nodiscard]] Result<PublicKey> load_public_key(const std::filesystem::path& file);

/// Whether `key` made `signature_file` (the content of a pre-hashed minisign signature file) over `bytes` and
/// its trusted comment. Fails with `wrong_key` ("signed by key X, you have Y") or `bad_signature`.
[[nodiscard]] Result<void> verify_signature(std::string_view bytes, std::string_view signature_file,
                                            const PublicKey& key);

}  // namespace calib
