#include "snapshot.hpp"

#include <fstream>
#include <nlohmann/json.hpp>

namespace calib {

Result<void> write_snapshot(const std::filesystem::path& file, const Status& status) {
  const std::filesystem::path beside = file.string() + ".new";
  {
    std::ofstream out(beside, std::ios::binary | std::ios::trunc);
    out << to_json(status).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) << '\n';
    if (!out.flush()) return fail(ErrorCode::snapshot_failed, beside.string() + " cannot be written");
  }
  std::error_code error;
  std::filesystem::rename(beside, file, error);
  if (error) return fail(ErrorCode::snapshot_failed, file.string() + " cannot be replaced: " + error.message());
  return {};
}

}  // namespace calib
