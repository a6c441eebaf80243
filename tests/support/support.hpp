#pragma once

#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "calib/result.hpp"

namespace calib::test {

/// The recorded drive (a KITTI raw `<date>/<drive>` folder) that `CALIB_KITTI_DRIVE` names; nothing when it is unset.
/// Throws when it is set and no such folder exists: a wrong path must not look like a skipped test.
[[nodiscard]] std::optional<std::filesystem::path> kitti_drive();

/// The DDS domain set apart for this test program (`CALIBD_TEST_DOMAIN`), 1..100.
[[nodiscard]] int dds_domain();

/// Says on standard output why the current test case does not run: `if (!drive) return skip("no recorded drive");`.
/// A program all of whose test cases were skipped exits with 77, which ctest shows as Skipped.
void skip(const std::string& reason);

/// The value of `result`; the test fails with the error's text when there is none.
template <typename ResultType>
[[nodiscard]] auto require_ok(ResultType&& result) {
  if (!result) throw std::runtime_error(std::string(to_string(result.error().code)) + ": " + result.error().context);
  if constexpr (!std::is_void_v<typename std::decay_t<ResultType>::value_type>)
    return *std::forward<ResultType>(result);
}

/// A new empty folder, removed with all that is in it at the end of its life.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;

  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace calib::test
