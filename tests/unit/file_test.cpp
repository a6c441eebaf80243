#include "calib/file.hpp"

#include <fcntl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstring>
#include <fstream>
#include <sstream>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using test::require_ok;
namespace fs = std::filesystem;

namespace {

void write(const fs::path& path, const std::string& bytes) { std::ofstream(path, std::ios::binary) << bytes; }

std::string content_of(const fs::path& path) {
  std::ostringstream content;
  content << std::ifstream(path, std::ios::binary).rdbuf();
  return content.str();
}

void make_socket(const fs::path& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  REQUIRE(path.native().size() < sizeof address.sun_path);
  std::memcpy(address.sun_path, path.c_str(), path.native().size());
  const int number = socket(AF_UNIX, SOCK_STREAM, 0);
  REQUIRE(bind(number, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0);
  close(number);
}

}  // namespace

TEST_CASE("a regular file is read whole, up to the limit and behind symbolic links too") {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "file", link = folder.path() / "link";
  const std::string bytes("zero\0byte, newline\n", 19);
  write(file, bytes);
  fs::create_symlink("file", link);
  CHECK(require_ok(read_regular_file(file, 19)) == bytes);
  CHECK(require_ok(read_regular_file(link, 1 << 20)) == bytes);
  const auto larger = read_regular_file(file, 18);
  REQUIRE_FALSE(larger);
  CHECK(larger.error().code == "file_too_large");
  CHECK(larger.error().context == file.string() + ": is larger than 18 bytes");
  fs::resize_file(file, (std::uintmax_t{1} << 40));  // takes no room on disk, and must take none in memory
  CHECK(read_regular_file(file, 1 << 20).error().context == file.string() + ": is larger than 1 MiB");
  write(file, "");
  CHECK(require_ok(read_regular_file(file, 0)).empty());
}

TEST_CASE("what is no regular file is refused at once, with its kind") {
  const test::TemporaryFolder folder;
  const fs::path fifo = folder.path() / "fifo", link = folder.path() / "link", unix_socket = folder.path() / "socket";
  REQUIRE(mkfifo(fifo.c_str(), 0600) == 0);
  fs::create_symlink("fifo", link);
  make_socket(unix_socket);
  const std::pair<fs::path, std::string> refused[] = {{folder.path(), "it is a folder"},
                                                      {fifo, "it is a FIFO"},
                                                      {link, "it is a FIFO"},
                                                      {unix_socket, "it is a socket"},
                                                      {"/dev/zero", "it is a device"}};
  for (const auto& [path, why] : refused) {
    const auto read = read_regular_file(path, 1 << 20);
    REQUIRE_FALSE(read);
    CHECK(read.error().code == "file_unreadable");
    CHECK(read.error().context == path.string() + ": cannot be read: " + why);
  }
}

TEST_CASE("a file that is not there is not found, and a link that goes in circles is unreadable") {
  const test::TemporaryFolder folder;
  write(folder.path() / "file", "");
  fs::create_symlink("nowhere", folder.path() / "dangling");
  fs::create_symlink("circle", folder.path() / "circle");
  for (const char* name : {"none", "none/file", "file/in/a/file", "dangling"}) {
    const auto read = read_regular_file(folder.path() / name, 1 << 20);
    REQUIRE_FALSE(read);
    CHECK(read.error().code == "file_not_found");
    CHECK(read.error().context.find(name) != std::string::npos);
  }
  CHECK(read_regular_file(folder.path() / "circle", 1 << 20).error().code == "file_unreadable");
}

TEST_CASE("a file is made or replaced, and nothing else is left in its folder") {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "file";
  write(folder.path() / "file.part", "of a program that was stopped");
  for (const std::string text : {"first", "second, which is longer", ""}) {
    require_ok(replace_file(file, text));
    CHECK(content_of(file) == text);
  }
  CHECK(std::distance(fs::directory_iterator(folder.path()), fs::directory_iterator()) == 1);
}

TEST_CASE("nothing is written through a symbolic link") {
  const test::TemporaryFolder folder;
  const fs::path target = folder.path() / "target", file = folder.path() / "file";
  write(target, "untouched");
  for (const char* name : {"file", "file.part"}) {
    INFO(name);
    fs::create_symlink("target", folder.path() / name);
    require_ok(replace_file(file, "new"));
    CHECK(content_of(target) == "untouched");
    CHECK_FALSE(fs::is_symlink(file));
    CHECK(content_of(file) == "new");
    fs::remove(file);
  }
}

TEST_CASE("what cannot be written is an error that names it, and is left as it was") {
  const test::TemporaryFolder folder;
  const fs::path fifo = folder.path() / "fifo";
  REQUIRE(mkfifo(fifo.c_str(), 0600) == 0);
  fs::create_directories(folder.path() / "blocked.part/in the way");
  for (const fs::path& path : {folder.path(), fifo, folder.path() / "none/file", folder.path() / "blocked",
                               folder.path() / std::string(255, 'n'), fs::path("/dev/null")}) {
    const auto written = replace_file(path, "text");
    REQUIRE_FALSE(written);
    CHECK(written.error().code == "write_failed");
    CHECK(written.error().context.find(path.string() + " cannot be written: ") == 0);
  }
  CHECK(fs::is_fifo(fifo));
}

TEST_CASE("a link is foreign when neither this user nor root has made it") {
  const test::TemporaryFolder folder;
  const fs::path link = folder.path() / "link";
  fs::create_symlink(folder.path(), link);
  CHECK_FALSE(is_foreign_link(link));
  CHECK_FALSE(is_foreign_link(folder.path()));
  CHECK_FALSE(is_foreign_link(folder.path() / "none"));
  if (lchown(link.c_str(), 65534, 65534) != 0) return test::skip("only root can give a link to somebody else");
  CHECK(is_foreign_link(link));
  CHECK(is_foreign_link(link.string() + "/"));
}
