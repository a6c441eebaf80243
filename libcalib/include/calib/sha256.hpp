#pragma once

#include <string>
#include <string_view>

namespace calib {

/// In lower-case hex, 64 characters.
[[nodiscard]] std::string sha256_hex(std::string_view bytes);

}  // namespace calib
