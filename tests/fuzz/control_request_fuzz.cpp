#include <nlohmann/json.hpp>

#include "control.hpp"
#include "fuzz/fuzz.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  return {octets(R"({"schema":1,"request":"status"})"),
          octets(R"({"schema":1,"request":"recalibrate","pair":"front","dry_run":true})"),
          octets(R"({"schema":1,"request":"rollback","pair":"front","to":3})")};
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const auto request = calib::parse_request(calib::fuzz::text(bytes, size));
  if (!request)
    calib::fuzz::require_code(request.error(), {calib::ErrorCode::bad_request});
  else
    calib::fuzz::require(request->is_object() && request->at("schema") == 1 && request->at("request").is_string());
  return 0;
}
