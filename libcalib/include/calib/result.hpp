#pragma once

#include <string>
#include <tl/expected.hpp>

#include "calib/error_code.hpp"

namespace calib {

/// What went wrong, for a program (`code`) and for a person (`context`).
struct Error {
  /// Counted, logged and shown by its word, `to_string(code)`.
  ErrorCode code;
  /// One sentence: the thing, what is wrong with it, and the remedy where there is one.
  /// May quote outside input; escape with `escape_control` before it reaches a terminal.
  std::string context;
};

/// A value, or why there is none. Nothing in calib returns identity, zero or NaN to mean "could not".
template <typename T>
using Result = tl::expected<T, Error>;

/// `return fail(ErrorCode::low_overlap, "...");` from a function that returns any `Result`.
[[nodiscard]] inline tl::unexpected<Error> fail(ErrorCode code, std::string context) {
  return tl::unexpected<Error>(Error{code, std::move(context)});
}

/// `if (!image) return propagate(image);` hands the error of a failed result to the caller.
template <typename T>
[[nodiscard]] tl::unexpected<Error> propagate(const Result<T>& failed) {
  return tl::unexpected<Error>(failed.error());
}

/// `text` with control characters, DEL and invalid UTF-8 replaced by `\xHH`, so that it can be shown on a terminal.
[[nodiscard]] std::string escape_control(std::string_view text);

}  // namespace calib
