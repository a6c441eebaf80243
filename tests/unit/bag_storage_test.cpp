#include "dataset/bag/bag_storage.hpp"

#include <lz4frame.h>
#include <sqlite3.h>
#include <zstd.h>

#include <fstream>

#include "dataset/bag/decompress.hpp"
#include "support/catch.hpp"
#include "support/mcap_bytes.hpp"
#include "support/support.hpp"

using namespace calib;
using test::McapBytes;
using test::stamped_cdr;
namespace fs = std::filesystem;

namespace {

Octets zstd(const Octets& plain) {
  Octets bytes(ZSTD_compressBound(plain.size()));
  bytes.resize(ZSTD_compress(bytes.data(), bytes.size(), plain.data(), plain.size(), 1));
  return bytes;
}

Octets lz4(const Octets& plain) {
  Octets bytes(LZ4F_compressFrameBound(plain.size(), nullptr));
  bytes.resize(LZ4F_compressFrame(bytes.data(), bytes.size(), plain.data(), plain.size(), nullptr));
  return bytes;
}

Octets noise(std::size_t size) {
  Octets bytes(size);
  std::uint32_t state = 1;
  for (auto& byte : bytes) byte = static_cast<std::uint8_t>((state = state * 1664525 + 1013904223) >> 24);
  return bytes;
}

McapBytes channels() {
  return McapBytes()
      .schema(1, bag_type::cloud)
      .schema(2, "std_msgs/msg/String")
      .channel(7, 1, "/points")
      .channel(8, 2, "/chatter");
}

McapBytes three_messages() {
  return channels().message(7, stamped_cdr(10, 1)).message(8, {0, 1, 0, 0, 9}).message(7, stamped_cdr(11, 2));
}

std::unique_ptr<BagStorage> open(const Octets& bytes) {
  return test::require_ok(open_mcap(std::make_unique<OctetSource>(bytes), "it.mcap"));
}

McapBytes begin() { return McapBytes().magic().header(); }

void check_three_messages(const BagStorage& bag) {
  REQUIRE(bag.topics().size() == 2);
  CHECK(bag.topics()[0].name == "/points");
  CHECK(bag.topics()[0].type == bag_type::cloud);
  CHECK(bag.topics()[0].messages == 2);
  CHECK(bag.topics()[1].messages == 1);
  REQUIRE(bag.messages().size() == 2);  // of types that are read
  CHECK(bag.messages()[0].stamp == std::chrono::seconds(10) + std::chrono::nanoseconds(1));
  CHECK(bag.messages()[1].stamp == std::chrono::seconds(11) + std::chrono::nanoseconds(2));
  CHECK(test::require_ok(bag.read(bag.messages()[0])) == stamped_cdr(10, 1));
  CHECK(test::require_ok(bag.read(bag.messages()[1])) == stamped_cdr(11, 2));
}

bool mentions(const BagStorage& bag, const std::string& text) {
  return std::ranges::any_of(bag.remarks(),
                             [&](const std::string& remark) { return remark.find(text) != std::string::npos; });
}

}  // namespace

TEST_CASE("what is compressed is decompressed, whole or cut, and no further than asked for") {
  for (const std::size_t size : {0, 1, 65536, 300'000}) {
    const Octets plain = noise(size);
    for (const bool is_zstd_frame : {true, false}) {
      const Octets packed = is_zstd_frame ? zstd(plain) : lz4(plain);
      const auto decompress = is_zstd_frame ? decompress_zstd : decompress_lz4;
      const auto all = decompress(packed, size);
      CHECK(all.complete);
      CHECK(all.bytes == plain);
      CHECK(decompress(packed, 2 * size + 1).bytes == plain);
      if (size < 2) continue;
      const auto less = decompress(packed, size - 1);
      CHECK_FALSE(less.complete);
      CHECK(less.bytes == Octets(plain.begin(), plain.end() - 1));
      const auto cut = decompress(std::span(packed).first(packed.size() / 2), size);
      CHECK_FALSE(cut.complete);
      CHECK(cut.bytes == Octets(plain.begin(), plain.begin() + static_cast<std::ptrdiff_t>(cut.bytes.size())));
    }
  }
  CHECK_FALSE(decompress_zstd(noise(100), 1000).complete);
  CHECK_FALSE(decompress_lz4(noise(100), 1000).complete);
  CHECK(is_zstd(zstd({1, 2, 3})));
  CHECK_FALSE(is_zstd(noise(100)));
  CHECK_FALSE(is_zstd({}));
}

TEST_CASE("a million zero bytes in a few hundred take no more memory than is asked for") {
  const Octets packed = zstd(Octets(10'000'000));
  CHECK(packed.size() < 2000);
  CHECK(decompress_zstd(packed, 1000).bytes.size() == 1000);
}

TEST_CASE("messages of an MCAP file are listed, in chunks of every compression and without") {
  check_three_messages(*open(begin().raw(three_messages().octets()).end().octets()));
  check_three_messages(*open(begin().chunk(three_messages()).end().octets()));
  const Octets records = three_messages().octets();
  check_three_messages(*open(begin().chunk(McapBytes().raw(zstd(records)), "zstd", records.size()).end().octets()));
  check_three_messages(*open(begin().chunk(McapBytes().raw(lz4(records)), "lz4", records.size()).end().octets()));
  CHECK(open(begin().chunk(three_messages()).end().octets())->remarks().empty());
}

TEST_CASE("a file without its end gives what comes before it, wherever it is cut") {
  const Octets whole = begin().chunk(three_messages()).raw(three_messages().octets()).end().octets();
  std::size_t most = 0;
  constexpr std::size_t end_bytes = 50;  // of DataEnd, Footer and magic
  for (std::size_t size = 8; size <= whole.size() - end_bytes; ++size) {
    const auto bag = open({whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size)});
    CHECK(mentions(*bag, "ends early"));
    CHECK(bag->messages().size() >= most);
    most = std::max(most, bag->messages().size());
    for (const BagMessage& message : bag->messages()) (void)test::require_ok(bag->read(message));
  }
  CHECK(most == 4);
}

TEST_CASE("sizes that are not true are not believed") {
  constexpr std::uint64_t huge = 0xFFFFFFFFFFFFFFFF;
  for (const std::uint64_t size : {huge, huge / 2, std::uint64_t{1} << 32}) {
    // Of a record, of a chunk's records, of what they decompress to, and of a string.
    CHECK(mentions(*open(begin().raw(channels().octets()).number(0x05, 1).number(size, 8).octets()), "ends early"));
    McapBytes chunk = McapBytes().number(0, 8).number(0, 8).number(size, 8).number(0, 4).text("").number(size, 8);
    CHECK(mentions(*open(begin().record(0x06, chunk.raw(three_messages().octets())).end().octets()), "damaged"));
    const auto bomb =
        open(begin().chunk(McapBytes().raw(zstd(three_messages().octets())), "zstd", size).end().octets());
    CHECK(bomb->messages().size() == 2);
    CHECK(mentions(*bomb, "1 of 1 chunks of it.mcap are damaged"));
    CHECK(open(begin().record(0x03, McapBytes().number(1, 2).number(size, 4)).end().octets())->topics().empty());
  }
}

TEST_CASE("what a later version or another writer adds is passed over") {
  const auto bag = open(begin()
                            .record(0x99, McapBytes().text("unknown"))
                            .record(0x09, McapBytes().number(0, 8))
                            .chunk(three_messages().chunk(three_messages()))  // no chunk is within another
                            .chunk(McapBytes().raw("?"), "brotli")
                            .end()
                            .octets());
  check_three_messages(*bag);
  CHECK(mentions(*bag, "compressed with 'brotli'"));
}

TEST_CASE("messages of no channel, and channels of no schema, belong to nothing") {
  const auto bag =
      open(begin().channel(1, 5, "/a").message(1, stamped_cdr(1, 1)).message(9, stamped_cdr(1, 1)).end().octets());
  REQUIRE(bag->topics().size() == 1);
  CHECK(bag->topics()[0].type.empty());
  CHECK(bag->topics()[0].messages == 1);
  CHECK(bag->messages().empty());
  // ROS 1 in MCAP.
  CHECK(
      open(begin().schema(1, bag_type::cloud).channel(1, 1, "/a", "ros1").message(1, stamped_cdr(1, 1)).end().octets())
          ->messages()
          .empty());
}

TEST_CASE("a stamp is read in either byte order, and is none where it cannot be") {
  CHECK(stamp_in(stamped_cdr(3, 4)) == std::chrono::seconds(3) + std::chrono::nanoseconds(4));
  CHECK(stamp_in(Octets{0, 0, 0, 0, 0, 0, 0, 3, 0, 0, 0, 4}) == std::chrono::seconds(3) + std::chrono::nanoseconds(4));
  CHECK(stamp_in(stamped_cdr(0x80000000, 4)) == BagMessage::no_stamp);
  CHECK(stamp_in(stamped_cdr(3, 1'000'000'000)) == BagMessage::no_stamp);
  CHECK(stamp_in(Octets{0, 1, 0, 0, 0}) == BagMessage::no_stamp);
  CHECK(stamp_in(Octets{9, 1, 0, 0, 0, 0, 0, 3, 0, 0, 0, 4}) == BagMessage::no_stamp);
}

TEST_CASE("messages that are compressed one by one are read") {
  const auto bag = open(begin().raw(channels().octets()).message(7, zstd(stamped_cdr(10, 1))).end().octets());
  REQUIRE(bag->messages().size() == 1);
  CHECK(bag->messages()[0].stamp == std::chrono::seconds(10) + std::chrono::nanoseconds(1));
  CHECK(test::require_ok(bag->read(bag->messages()[0])) == stamped_cdr(10, 1));
  Octets damaged = zstd(stamped_cdr(10, 1));
  damaged.pop_back();
  const auto other = open(begin().raw(channels().octets()).message(7, damaged).end().octets());
  CHECK(other->read(other->messages().at(0)).error().code == ErrorCode::file_unreadable);
}

namespace {

void execute(const fs::path& path, const std::string& sql) {
  sqlite3* database = nullptr;
  REQUIRE(sqlite3_open(path.c_str(), &database) == SQLITE_OK);
  CHECK(sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr) == SQLITE_OK);
  sqlite3_close(database);
}

const std::string tables =
    "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
    "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);"
    "INSERT INTO topics VALUES(1, '/points', 'sensor_msgs/msg/PointCloud2', 'cdr'), (2, '/chatter', "
    "'std_msgs/msg/String', 'cdr');";

}  // namespace

TEST_CASE("messages of a database are listed and read") {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "a b%20#?.db3";
  execute(path, tables +
                    "INSERT INTO messages VALUES(1, 1, 5, x'000100000A00000001000000060000006C6964617200'),"
                    "(2, 2, 6, x'0001000009'), (5, 1, 7, x'000100000B00000002000000060000006C6964617200');");
  check_three_messages(*test::require_ok(open_bag_storage(path)));
}

TEST_CASE("values of a database that are of no use are left out") {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "a.db3";
  execute(path, tables +
                    "INSERT INTO messages VALUES(1, 1, 5, NULL), (2, 1, 6, x''), (3, 77, 7, x'00'), (4, 1, 8, 'text'), "
                    "(-5, 1, 9, "
                    "x'000100000B00000002000000');");
  const auto bag = test::require_ok(open_bag_storage(path));
  CHECK(bag->messages().size() == 4);
  std::size_t stamped = 0;
  for (const BagMessage& message : bag->messages()) {
    stamped += message.stamp != BagMessage::no_stamp;
    (void)bag->read(message);
  }
  CHECK(stamped == 1);
}

TEST_CASE("a database that computes is not one of rosbag2") {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "a.db3";
  execute(path,
          "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
          "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) SELECT id, 1 AS "
          "topic_id, 1 "
          "AS timestamp, x'00' AS data FROM n;");
  CHECK(open_bag_storage(path).error().code == ErrorCode::file_unreadable);
  CHECK(open_bag_storage(folder.path() / "none.db3").error().code == ErrorCode::file_not_found);
  CHECK(open_bag_storage(folder.path()).error().code == ErrorCode::file_unreadable);
}
