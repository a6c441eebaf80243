#pragma once

#include <string>
#include <tl/expected.hpp>

namespace calib {

/// What went wrong, for a program (`code`) and for a person (`context`).
struct Error {
  /// Stable snake_case word, sometimes with a detail after a colon, e.g. `low_overlap`, `malformed:point_step`.
  /// It is counted, logged and shown as it is, so it never holds text from outside.
  std::string code;
  /// One sentence: the thing, what is wrong with it, and the remedy where there is one.
  /// May quote outside input; escape with `escape_control` before it reaches a terminal.
  std::string context;
};

/// A value, or why there is none. Nothing in calib returns identity, zero or NaN to mean "could not".
template <typename T>
using Result = tl::expected<T, Error>;

/// `return fail("low_overlap", "...");` from a function that returns any `Result`.
[[nodiscard]] inline tl::unexpected<Error> fail(std::string code, std::string context) {
  return tl::unexpected<Error>(Error{std::move(code), std::move(context)});
}

/// `text` with control characters, DEL and invalid UTF-8 replaced by `\xHH`, so that it can be shown on a terminal.
[[nodiscard]] std::string escape_control(std::string_view text);

}  // namespace calib
