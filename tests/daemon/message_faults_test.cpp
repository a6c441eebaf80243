#include "message_faults.hpp"

#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;

TEST_CASE("every code of a malformed message has its cause and its remedy, and its place in the manual") {
  const std::filesystem::path source = std::getenv("CALIBD_SOURCE_DIR");
  std::ifstream page(source / "systemd/calibd-messages.5.scd");
  const std::string manual{std::istreambuf_iterator<char>(page), {}};
  std::ifstream table(source / "systemd/codes.txt");
  const std::string codes{std::istreambuf_iterator<char>(table), {}};
  for (const ErrorCode code : all_error_codes) {
    if (!is_malformed(code) && code != ErrorCode::image_bits && code != ErrorCode::image_size_mismatch) continue;
    INFO(to_string(code));
    const MessageFault& fault = message_fault(code);
    CHECK(fault.code == code);
    CHECK_FALSE(fault.cause.empty());
    CHECK_FALSE(fault.remedy.empty());
    std::string word(to_string(code));
    // What calibctl explains is the same.
    const std::size_t at_page = codes.find("\n[" + word + "]\ncause: " + std::string(fault.cause) + "\nexample: ");
    REQUIRE(at_page != std::string::npos);
    CHECK(codes.find("\nremedy: " + std::string(fault.remedy) + "\n", at_page) < codes.find("\n[", at_page + 1));
    for (std::size_t at = 0; (at = word.find('_', at)) != std::string::npos; at += 2) word.insert(at, "\\");
    CHECK(manual.find('*' + word + "*\n\tBound: ") != std::string::npos);
  }
}
