#pragma once

#include <exception>
#include <new>
#include <string>

#include "calib/result.hpp"

namespace calib {

/// What `decode` returns, a `Result`. Nothing that is thrown over a message may end the daemon: it becomes
/// `out_of_memory` or `malformed:refused`.
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
