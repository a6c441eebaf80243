#include "calib/signature.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <sstream>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using calib::test::require_ok;
using calib::test::TemporaryFolder;
using Catch::Matchers::ContainsSubstring;

namespace {

std::string content_of(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::ostringstream content;
  content << in.rdbuf();
  return content.str();
}

void write(const std::filesystem::path& file, std::string_view content) {
  std::ofstream(file, std::ios::binary) << content;
}

/// True when the shell command ends with 0; the paths used here hold nothing that a shell would read.
bool succeeds(const std::string& command) { return std::system((command + " >/dev/null 2>&1").c_str()) == 0; }

struct Fixture {
  TemporaryFolder folder;
  std::filesystem::path key_file = folder.path() / "signing.key", public_file = folder.path() / "signing.pub",
                        message_file = folder.path() / "message", signature_file = folder.path() / "message.minisig";
  std::string message = std::string("zero\0byte, newline\n", 19);

  Fixture() { write(message_file, message); }
  /// minisign asks for a password on a terminal unless the key has none.
  [[nodiscard]] std::string minisign(const std::string& options) const {
    return "minisign " + options + " -s " + key_file.string() + " -p " + public_file.string();
  }
};

std::string replaced(std::string text, std::size_t line, const std::string& with) {
  std::size_t start = 0;
  while (line-- > 0) start = text.find('\n', start) + 1;
  return text.replace(start, text.find('\n', start) - start, with);
}

}  // namespace

TEST_CASE_METHOD(Fixture, "minisign accepts what calibd signs, and refuses it for other bytes") {
  const SigningKey key = SigningKey::generate();
  require_ok(key.save(key_file));
  write(signature_file, key.sign(message, "a comment\twith a tab"));
  CHECK(succeeds("minisign -V -p " + public_file.string() + " -m " + message_file.string()));
  write(message_file, message + " ");
  CHECK_FALSE(succeeds("minisign -V -p " + public_file.string() + " -m " + message_file.string()));
}

TEST_CASE_METHOD(Fixture, "minisign signs with a key that calibd made") {
  const SigningKey key = SigningKey::generate();
  require_ok(key.save(key_file));
  REQUIRE(succeeds(minisign("-S -m " + message_file.string())));
  require_ok(verify_signature(message, content_of(signature_file), key.public_key()));
  CHECK(verify_signature(message + " ", content_of(signature_file), key.public_key()).error().code == "bad_signature");
}

TEST_CASE_METHOD(Fixture, "calibd signs with a key that minisign made") {
  REQUIRE(succeeds(minisign("-G -W")));
  const SigningKey key = require_ok(SigningKey::load(key_file));
  const PublicKey public_key = require_ok(load_public_key(public_file));
  CHECK(key.public_key().key == public_key.key);
  CHECK(key.public_key().id == public_key.id);
  // minisign leaves leading zeros of the key id out.
  const std::string id = public_key.id_text();
  CHECK_THAT(content_of(public_file), ContainsSubstring(" " + id.substr(id.find_first_not_of('0')) + "\n"));
  write(signature_file, key.sign(message, "comment"));
  CHECK(succeeds("minisign -V -p " + public_file.string() + " -m " + message_file.string()));
  require_ok(verify_signature(message, key.sign(message, "comment"), public_key));
}

TEST_CASE_METHOD(Fixture, "a saved key is private and comes back the same") {
  const SigningKey key = SigningKey::generate();
  require_ok(key.save(key_file));
  struct stat secret_file {
  }, open_file{};
  REQUIRE(stat(key_file.c_str(), &secret_file) == 0);
  REQUIRE(stat(public_file.c_str(), &open_file) == 0);
  CHECK((secret_file.st_mode & 0777) == 0600);
  CHECK((open_file.st_mode & 0777) == 0644);
  const SigningKey loaded = require_ok(SigningKey::load(key_file));
  CHECK(loaded.sign(message, "comment") == key.sign(message, "comment"));
}

TEST_CASE_METHOD(Fixture, "saving a key overwrites neither file and leaves no half pair") {
  const SigningKey key = SigningKey::generate();
  write(public_file, "somebody's");
  CHECK(key.save(key_file).error().code == "key_exists");
  CHECK(content_of(public_file) == "somebody's");
  CHECK_FALSE(std::filesystem::exists(key_file));
  std::filesystem::remove(public_file);
  require_ok(key.save(key_file));
  const std::string before = content_of(key_file);
  CHECK(SigningKey::generate().save(key_file).error().code == "key_exists");
  CHECK(content_of(key_file) == before);
  CHECK(key.save(folder.path() / "other.pub").error().code == "bad_name");
  CHECK(key.save(folder.path() / "no_folder" / "x.key").error().code == "key_not_written");
}

TEST_CASE_METHOD(Fixture, "keys that cannot be used are refused, each with its reason") {
  CHECK(SigningKey::load(key_file).error().code == "key_not_found");
  CHECK(load_public_key(public_file).error().code == "key_not_found");
  const SigningKey key = SigningKey::generate();
  require_ok(key.save(key_file));
  CHECK(SigningKey::load(public_file).error().code == "key_permissions");
  CHECK(load_public_key(key_file).error().code == "bad_key");

  REQUIRE(chmod(key_file.c_str(), 0604) == 0);
  CHECK(SigningKey::load(key_file).error().code == "key_permissions");
  REQUIRE(chmod(key_file.c_str(), 0440) == 0);  // a systemd credential
  CHECK(SigningKey::load(key_file));
  REQUIRE(chmod(key_file.c_str(), 0600) == 0);

  std::string damaged = content_of(key_file);
  const std::size_t inside_the_secret = damaged.find('\n') + 1 + 100;
  damaged[inside_the_secret] = damaged[inside_the_secret] == 'A' ? 'B' : 'A';
  write(key_file, damaged);
  CHECK(SigningKey::load(key_file).error().code == "bad_key");
  for (const std::string content :
       {"", "one line", "untrusted comment: x\nnot base64!\n", "untrusted comment: x\nRWQ=\n"}) {
    write(key_file, content);
    CHECK(SigningKey::load(key_file).error().code == "bad_key");
    CHECK(load_public_key(key_file).error().code == "bad_key");
  }
  CHECK(SigningKey::load(folder.path()).error().code == "bad_key");
}

TEST_CASE_METHOD(Fixture, "a key with a password is refused with the remedy") {
  REQUIRE(succeeds("printf 'secret\\nsecret\\n' | " + minisign("-G")));
  const auto loaded = SigningKey::load(key_file);
  REQUIRE_FALSE(loaded);
  CHECK_THAT(loaded.error().context, ContainsSubstring("password") && ContainsSubstring("calibctl keygen"));
}

TEST_CASE("the wrong key is named, and so is the one that signed") {
  const SigningKey signer = SigningKey::generate(), other = SigningKey::generate();
  const auto verified = verify_signature("bytes", signer.sign("bytes", "comment"), other.public_key());
  REQUIRE_FALSE(verified);
  CHECK(verified.error().code == "wrong_key");
  CHECK_THAT(verified.error().context, ContainsSubstring("signed by key " + signer.public_key().id_text()) &&
                                           ContainsSubstring("you have " + other.public_key().id_text()));
}

TEST_CASE("a key that only claims the signer's id does not verify") {
  const SigningKey signer = SigningKey::generate();
  PublicKey forged = SigningKey::generate().public_key();
  forged.id = signer.public_key().id;
  CHECK(verify_signature("bytes", signer.sign("bytes", "comment"), forged).error().code == "bad_signature");
}

TEST_CASE("the trusted comment is signed, and the signature file has one form") {
  const SigningKey key = SigningKey::generate();
  const std::string file = key.sign("bytes", "sequence 7");
  const auto code = [&](const std::string& signature) {
    const auto verified = verify_signature("bytes", signature, key.public_key());
    return verified ? "" : word(verified.error().code);
  };
  CHECK(code(file).empty());
  CHECK(code(replaced(file, 0, "untrusted comment: anything")).empty());
  CHECK(code(replaced(file, 2, "trusted comment: sequence 8")) == "bad_signature");
  CHECK(code(replaced(file, 2, "trusted comment: ")) == "bad_signature");
  CHECK(code(replaced(file, 0, "no comment")) == "bad_signature");
  CHECK(code(replaced(file, 3, "")) == "bad_signature");
  CHECK(code(file + "more\n") == "bad_signature");
  CHECK(code("") == "bad_signature");
  CHECK(code("\n\n\n\n") == "bad_signature");
  CHECK(code(std::string(4096, '\0')) == "bad_signature");
}

TEST_CASE_METHOD(Fixture, "carriage returns at the ends of lines are accepted wherever minisign accepts them") {
  const SigningKey key = SigningKey::generate();
  require_ok(key.save(key_file));
  const auto with_returns = [](std::string text) {
    for (std::size_t at = 0; (at = text.find('\n', at)) != std::string::npos; at += 2) text.insert(at, "\r");
    return text;
  };
  const std::string signature = with_returns(key.sign(message, "sequence 7"));
  require_ok(verify_signature(message, signature, key.public_key()));
  CHECK_FALSE(verify_signature(message, with_returns(signature), key.public_key()));  // two of them
  std::string amid = key.sign(message, "sequence 7");
  amid.insert(amid.size() - 9, "\r");
  CHECK_FALSE(verify_signature(message, amid, key.public_key()));

  write(signature_file, signature);
  write(public_file, with_returns(content_of(public_file)));
  CHECK(succeeds("minisign -V -p " + public_file.string() + " -m " + message_file.string()));
  CHECK(require_ok(load_public_key(public_file)).id == key.public_key().id);
  write(key_file, with_returns(content_of(key_file)));
  CHECK(require_ok(SigningKey::load(key_file)).public_key().id == key.public_key().id);
}

TEST_CASE_METHOD(Fixture, "minisign's older form without a hash is refused") {
  const SigningKey key = SigningKey::generate();
  require_ok(key.save(key_file));
  REQUIRE(succeeds(minisign("-S -l -m " + message_file.string())));
  CHECK(verify_signature(message, content_of(signature_file), key.public_key()).error().code == "bad_signature");
}

TEST_CASE("empty bytes can be signed") {
  const SigningKey key = SigningKey::generate();
  require_ok(verify_signature("", key.sign("", ""), key.public_key()));
}

TEST_CASE("a message authentication code is of one key, one purpose and one message") {
  const SigningKey key = SigningKey::generate(), other = SigningKey::generate();
  const std::string mac = key.mac("a purpose", "a message");
  CHECK(mac.size() == 64);
  CHECK(mac == key.mac("a purpose", "a message"));
  CHECK(key.is_mac("a purpose", "a message", mac));
  CHECK_FALSE(other.is_mac("a purpose", "a message", mac));
  CHECK_FALSE(key.is_mac("another", "a message", mac));
  CHECK_FALSE(key.is_mac("a purpose", "a massage", mac));
  CHECK_FALSE(key.is_mac("a purpose", "a message", mac.substr(1)));
  CHECK_FALSE(key.is_mac("a purpose", "a message", ""));
}

// AddressSanitizer locks no memory.
TEST_CASE("a secret lies in memory that is not swapped out and not written into core files, and goes with the key",
          "[release-only]") {
  // VmFlags of proc(5): `lo` locked, `dd` not in core files.
  const auto locked_mappings = [] {
    std::ifstream file("/proc/self/smaps");
    int count = 0;
    for (std::string line; std::getline(file, line);)
      count += line.starts_with("VmFlags:") && line.find(" lo") != std::string::npos &&
               line.find(" dd") != std::string::npos;
    return count;
  };
  const int before = locked_mappings();
  {
    SigningKey key = SigningKey::generate();
    CHECK(locked_mappings() == before + 1);
    const SigningKey moved = std::move(key);
    CHECK(locked_mappings() == before + 1);
    CHECK(moved.mac("a purpose", "a message").size() == 64);
  }
  CHECK(locked_mappings() == before);
}

TEST_CASE("a key is read from an open file, too, and its public half from a word") {
  const TemporaryFolder folder;
  const SigningKey key = SigningKey::generate();
  require_ok(key.save(folder.path() / "a.key"));
  const int file = ::open((folder.path() / "a.key").c_str(), O_RDONLY);
  for (int i = 0; i < 2; ++i) CHECK(require_ok(SigningKey::load(file, "it")).public_key() == key.public_key());
  ::close(file);
  CHECK(require_ok(parse_public_key(key.public_key().text())) == key.public_key());
  CHECK(SigningKey::load(file, "it").error().code == "bad_key");
  for (const std::string& bad :
       {std::string(), std::string("RWQ="), key.public_key().text() + "=", "\n" + key.public_key().text()})
    CHECK(parse_public_key(bad).error().code == "bad_key");
}

TEST_CASE("a key that was moved from holds no secret any more") {
  SigningKey key = SigningKey::generate();
  const std::string before = key.sign("bytes", "comment");
  const SigningKey moved = std::move(key);
  CHECK(moved.sign("bytes", "comment") == before);
  CHECK(key.public_key().key == std::array<std::uint8_t, 32>{});  // NOLINT: looking is the point
}
