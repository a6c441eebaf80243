#include "snapshot.hpp"

#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

std::string text_of(const std::filesystem::path& file) {
  std::ifstream in(file);
  return {std::istreambuf_iterator<char>(in), {}};
}

Status status(const std::string& vehicle) {
  Status status;
  status.vehicle = vehicle;
  return status;
}

}  // namespace

TEST_CASE("a snapshot is the status as one line of JSON, and the only file left") {
  const TemporaryFolder folder;
  const auto file = folder.path() / "status.json";
  require_ok(write_snapshot(file, status("first")));
  require_ok(write_snapshot(file, status("second")));
  const std::string text = text_of(file);
  CHECK(text.find('\n') == text.size() - 1);
  CHECK(require_ok(parse_status(nlohmann::json::parse(text))).vehicle == "second");
  CHECK(std::distance(std::filesystem::directory_iterator(folder.path()), {}) == 1);
}

TEST_CASE("text that is not UTF-8 does not prevent a snapshot") {
  const TemporaryFolder folder;
  const auto file = folder.path() / "status.json";
  require_ok(write_snapshot(file, status("a\xff")));
  CHECK(nlohmann::json::parse(text_of(file))["vehicle"] == "a\xEF\xBF\xBD");
}

TEST_CASE("a snapshot that cannot be written fails, and leaves the last one") {
  const TemporaryFolder folder;
  CHECK_FALSE(write_snapshot(folder.path() / "missing" / "status.json", status("car")));
  const auto taken = folder.path() / "status.json";
  std::filesystem::create_directory(taken);
  std::ofstream(taken / "kept") << "x";
  const auto refused = write_snapshot(taken, status("car"));
  REQUIRE_FALSE(refused);
  CHECK_THAT(refused.error().context, Catch::Matchers::Contains("status.json cannot be replaced"));
  CHECK(std::filesystem::exists(taken / "kept"));

  const auto file = folder.path() / "other.json";
  require_ok(write_snapshot(file, status("first")));
  std::filesystem::create_directory(file.string() + ".new");
  CHECK_FALSE(write_snapshot(file, status("second")));
  CHECK(require_ok(parse_status(nlohmann::json::parse(text_of(file)))).vehicle == "first");
}
