#pragma once

#include <string_view>

#include "calib/error_code.hpp"

namespace calib {

/// Why a message has a fault, and what to do about it: at calibd's side where that is possible, since most users cannot
/// change a driver. The value and its bound are in the error's context.
struct MessageFault {
  ErrorCode code;
  std::string_view cause, remedy;
};

/// Of every code `malformed:*`, and of the others that a message is refused or remarked for.
[[nodiscard]] const MessageFault& message_fault(ErrorCode code);

}  // namespace calib
