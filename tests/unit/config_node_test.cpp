#include "calib/config_node.hpp"

#include <fstream>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

namespace {

/// What `read` refuses in `yaml`; empty when it takes it.
template <typename Read>
std::string refusal(const std::string& yaml, Read read) {
  const auto parsed = parse_config_text(yaml, "c.yaml", [&](const ConfigNode& top) { read(top); });
  return parsed ? "" : parsed.error().context;
}

/// What is refused of the value in `a: VALUE`.
template <typename Read>
std::string refused_value(const std::string& value, Read read) {
  return refusal("a: " + value + "\n", [&](const ConfigNode& top) { read(top.at("a")); });
}

/// The canonical form of `a: VALUE`.
std::string canonical(const std::string& value) {
  std::string text;
  require_ok(
      parse_config_text("a: " + value, "c.yaml", [&](const ConfigNode& top) { text = top.at("a").canonical(); }));
  return text;
}

}  // namespace

TEST_CASE("a mapping holds the keys that are allowed, each once") {
  const auto read = [](const ConfigNode& top) { top.with_keys({"a", "b"}); };
  CHECK(refusal("a: 1\nb: 2\n", read).empty());
  CHECK(refusal("a: 1\nc: 2\n", read) == "c.yaml:2: c: unknown key; known keys are a, b");
  CHECK(refusal("a: 1\n\na: 2\n", read) == "c.yaml:3: a: given twice; remove one");
  CHECK(refusal("[1, 2]\n", read) == "c.yaml:1: needs a mapping with the keys a, b");
}

TEST_CASE("a refusal names the line and the path of the key") {
  const auto read = [](const ConfigNode& top) {
    for (const ConfigNode& item : top.at("pairs").items()) (void)item.at("camera").at("size").integer(1, 9);
  };
  CHECK(refusal("pairs:\n  - camera: {size: 3}\n  - camera:\n      size: 12\n", read) ==
        "c.yaml:4: pairs[1].camera.size: 12 is outside 1 .. 9");
  CHECK(refusal("pairs:\n  - camera: {}\n", read) == "c.yaml:2: pairs[0].camera.size: missing; add it");
  CHECK(refusal("pairs: 3\n", read) == "c.yaml:1: pairs: needs a list");
}

TEST_CASE("numbers are finite, within bounds, and not quoted") {
  const auto number = [](const ConfigNode& node) { (void)node.number(-1, 2); };
  CHECK(refused_value("0.5", number).empty());
  CHECK(refused_value("5e-1", number).empty());
  for (const char* value : {"'0.5'", "half", "0.5m", ".nan", "inf", "[0.5]", "", "0x1p-1 "}) {
    INFO(value);
    CHECK(refused_value(value, number) == "c.yaml:1: a: needs a number");
  }
  CHECK(refused_value("2.5", number) == "c.yaml:1: a: 2.5 is outside -1 .. 2");
  const auto list = [](const ConfigNode& node) { (void)node.numbers(2, 0, 9); };
  CHECK(refused_value("[1, 2]", list).empty());
  CHECK(refused_value("[1]", list) == "c.yaml:1: a: needs a list of 2 numbers");
  CHECK(refused_value("[1, x]", list) == "c.yaml:1: a[1]: needs a number");
}

TEST_CASE("whole numbers and booleans are written as such") {
  const auto integer = [](const ConfigNode& node) { (void)node.integer(1, 9); };
  CHECK(refused_value("9", integer).empty());
  CHECK(refused_value("1.0", integer) == "c.yaml:1: a: needs a whole number");
  CHECK(refused_value("10", integer) == "c.yaml:1: a: 10 is outside 1 .. 9");
  CHECK(refused_value("99999999999999999999", integer) == "c.yaml:1: a: needs a whole number");
  const auto boolean = [](const ConfigNode& node) { (void)node.boolean(); };
  CHECK(refused_value("true", boolean).empty());
  for (const char* value : {"yes", "True", "1", "'true'"}) {
    INFO(value);
    CHECK(refused_value(value, boolean) == "c.yaml:1: a: needs true or false");
  }
}

TEST_CASE("text has 1 .. 4096 characters, none of them a control character") {
  const auto text = [](const ConfigNode& node) { (void)node.text(); };
  CHECK(refused_value("front", text).empty());
  CHECK(refused_value(std::string(4096, 'x'), text).empty());
  for (const std::string& value : {std::string("''"), std::string(4097, 'x'), std::string("\"a\\tb\"")})
    CHECK(refused_value(value, text) == "c.yaml:1: a: needs text of 1 .. 4096 characters without control characters");
  CHECK(refused_value("{b: 1}", text) == "c.yaml:1: a: needs text");
}

TEST_CASE("a duration has a unit, and is compared in whole nanoseconds") {
  const auto duration = [](const ConfigNode& node) { return node.duration(100ms, 2min); };
  const auto value = [&](const std::string& text) {
    std::chrono::nanoseconds read{};
    require_ok(parse_config_text("a: " + text, "c.yaml", [&](const ConfigNode& top) { read = duration(top.at("a")); }));
    return read;
  };
  CHECK(value("500ms") == 500ms);
  CHECK(value("1.9s") == 1900ms);
  CHECK(value("2min") == 2min);
  CHECK(value("0.01h") == 36s);
  CHECK(value("100ms") == 100ms);
  CHECK(refused_value("99ms", duration) == "c.yaml:1: a: 99ms is outside 0.1s .. 120s");
  CHECK(refused_value("1e300h", duration) == "c.yaml:1: a: 1e300h is outside 0.1s .. 120s");
  for (const char* text : {"10", "s", "10 s", "-s", "infs"}) {
    INFO(text);
    CHECK(refused_value(text, duration) == "c.yaml:1: a: needs a duration such as 500ms, 10s or 2min");
  }
}

TEST_CASE("the canonical form depends on values alone, not on layout, order and comments") {
  CHECK(canonical("{c: 1, b: [x, y]}") == canonical("\n  b:\n    - x  # first\n    - y\n  c: 1\n"));
  CHECK(canonical("{b: 1}") != canonical("{b: 2}"));
  CHECK(canonical("[x, y]") != canonical("[y, x]"));
  CHECK(canonical("{b: 1, c: 2}") == R"({b:"1",c:"2",})");
}

TEST_CASE("a file holds one YAML document of at most 1 MiB") {
  const auto nothing = [](const ConfigNode&) {};
  for (const std::string yaml : {"", "a: 1\n---\nb: 2\n", "# nothing\n"}) {
    INFO(yaml);
    CHECK(refusal(yaml, nothing) == "c.yaml:1: the file must hold one YAML document");
  }
  CHECK_THAT(refusal("a: [1\n", nothing), Catch::Matchers::Contains("not YAML: "));
  CHECK(refusal("a: " + std::string(1 << 20, 'x'), nothing) == "c.yaml:1: is larger than 1 MiB");
}

TEST_CASE("the text of a configuration is read from a regular file of at most 1 MiB") {
  const TemporaryFolder folder;
  const auto file = folder.path() / "c.yaml";
  CHECK_FALSE(read_config_text(file));
  std::ofstream(file) << "a: 1\n";
  CHECK(require_ok(read_config_text(file)) == "a: 1\n");
  CHECK_FALSE(read_config_text(folder.path()));
  std::ofstream(file) << std::string((1 << 20) + 1, 'x');
  const auto large = read_config_text(file);
  REQUIRE_FALSE(large);
  CHECK(large.error().context == file.string() + ":1: is larger than 1 MiB");
}
