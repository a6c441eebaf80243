#include "build_id.hpp"

#include <unistd.h>

#include <array>
#include <cstdio>
#include <string>

#include "support/catch.hpp"

namespace {

std::string output_of(const char* command) {
  std::FILE* pipe = popen(command, "r");
  REQUIRE(pipe != nullptr);
  std::string text;
  std::array<char, 4096> buffer;
  while (const std::size_t count = std::fread(buffer.data(), 1, buffer.size(), pipe)) text.append(buffer.data(), count);
  REQUIRE(pclose(pipe) == 0);
  return text;
}

}  // namespace

TEST_CASE("the running program's build id is the one that readelf reads in its file") {
  const auto id = calib::build_id();
  REQUIRE(id);
  CHECK(id->size() == 40);  // SHA-1
  CHECK(id->find_first_not_of("0123456789abcdef") == std::string::npos);
  const std::string notes = output_of(("readelf --notes /proc/" + std::to_string(getpid()) + "/exe").c_str());
  INFO(notes);
  CHECK(notes.find("Build ID: " + *id + "\n") != std::string::npos);
}
