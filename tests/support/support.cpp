#include "support/support.hpp"

#include <stdlib.h>

#include <cstdlib>

namespace calib::test {

std::optional<std::filesystem::path> kitti_drive() {
  const char* drive = std::getenv("CALIB_KITTI_DRIVE");
  if (drive == nullptr || *drive == '\0') return std::nullopt;
  if (!std::filesystem::is_directory(drive))
    throw std::runtime_error(std::string("CALIB_KITTI_DRIVE names no folder: ") + drive);
  return drive;
}

int dds_domain() {
  const char* domain = std::getenv("CALIBD_TEST_DOMAIN");
  if (domain == nullptr) throw std::runtime_error("CALIBD_TEST_DOMAIN is not set: run this test through ctest");
  return std::stoi(domain);
}

TemporaryFolder::TemporaryFolder() {
  std::string pattern = std::filesystem::temp_directory_path() / "calibd-test-XXXXXX";
  if (mkdtemp(pattern.data()) == nullptr) throw std::runtime_error("cannot make a temporary folder: " + pattern);
  path_ = pattern;
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

}  // namespace calib::test
