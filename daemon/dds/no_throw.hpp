#pragma once

#include <exception>
#include <new>
#include <string>

#include "calib/result.hpp"

namespace calib {

/// Calls `decode`, which returns a `Result`, and turns an exception into `out_of_memory` or `malformed:refused`: no
/// message may end the daemon.
template <typename Decode>
auto no_throw(Decode decode) -> decltype(decode()) {
  try {
    return decode();
  } catch (const std::bad_alloc&) {
    return fail(ErrorCode::out_of_memory, "there is no memory for the message");
  } catch (const std::exception& e) {
    return fail(ErrorCode::malformed_refused, std::string("it cannot be decoded: ") + e.what());
  }
}

}  // namespace calib
