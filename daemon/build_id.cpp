#include "build_id.hpp"

namespace calib {
Result<std::string> build_id() { return std::string("00"); }
}  // namespace calib
