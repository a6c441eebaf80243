#include "calib/result.hpp"

#include <cstdint>
#include <random>

#include "support/catch.hpp"

using calib::escape_control;

TEST_CASE("text for people passes unchanged") {
  for (const std::string text : {"", "camera front", "Straße 12 — 日本 🚗", "a\\x00b", "\"quoted\""})
    CHECK(escape_control(text) == text);
}

TEST_CASE("control characters are shown as hexadecimal, NUL included") {
  CHECK(escape_control(std::string("a\0b", 3)) == "a\\x00b");
  CHECK(escape_control("\x1b[2J\x07\n\r\t\x7f") == "\\x1b[2J\\x07\\x0a\\x0d\\x09\\x7f");
}

TEST_CASE("C1 controls and marks that reorder text are escaped although they are valid UTF-8") {
  CHECK(escape_control("\xc2\x9b") == "\\xc2\\x9b");           // CSI as one character
  CHECK(escape_control("\xe2\x80\xae") == "\\xe2\\x80\\xae");  // right-to-left override
  CHECK(escape_control("\xe2\x81\xa6") == "\\xe2\\x81\\xa6");  // left-to-right isolate
  CHECK(escape_control("\xef\xbb\xbf") == "\\xef\\xbb\\xbf");  // byte order mark
}

TEST_CASE("invalid UTF-8 is escaped byte by byte, and what follows it is kept") {
  CHECK(escape_control("\xc0\xafz") == "\\xc0\\xafz");                    // overlong
  CHECK(escape_control("\xe0\x80\xafz") == "\\xe0\\x80\\xafz");           // overlong
  CHECK(escape_control("\xed\xa0\x80z") == "\\xed\\xa0\\x80z");           // surrogate
  CHECK(escape_control("\xf4\x90\x80\x80z") == "\\xf4\\x90\\x80\\x80z");  // beyond U+10FFFF
  CHECK(escape_control("\xe2\x82") == "\\xe2\\x82");                      // cut short
  CHECK(escape_control("\xe2\x82z") == "\\xe2\\x82z");
  CHECK(escape_control("\xffz") == "\\xffz");
}

TEST_CASE("whatever the bytes, the escaped text holds no control character and escaping it again changes nothing") {
  std::mt19937 random(1);
  std::uniform_int_distribution<int> byte(0, 255), length(0, 40);
  for (int i = 0; i < 20'000; ++i) {
    std::string text(length(random), '\0');
    for (char& c : text) c = static_cast<char>(byte(random));
    const std::string escaped = escape_control(text);
    for (const char c : escaped) {
      const auto value = static_cast<std::uint8_t>(c);
      REQUIRE(value >= 0x20);
      REQUIRE(value != 0x7f);
    }
    REQUIRE(escape_control(escaped) == escaped);
  }
}

TEST_CASE("a failed result carries its code and context") {
  const calib::Result<int> result = calib::fail(calib::ErrorCode::low_overlap, "only 3 points are in the image");
  REQUIRE_FALSE(result);
  CHECK(result.error().code == "low_overlap");
  CHECK(result.error().context == "only 3 points are in the image");
}
