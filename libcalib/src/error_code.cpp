#include "calib/error_code.hpp"

#include <algorithm>

namespace calib {
namespace {

struct Entry {
  std::string_view word;
  bool malformed;
};

/// In the order of the enumerators.
constexpr std::array table{
#define CALIB_CODE(name) Entry{#name, false},
#define CALIB_MALFORMED(name) Entry{"malformed:" #name, true},
    CALIB_ERROR_CODES(CALIB_CODE, CALIB_MALFORMED)
#undef CALIB_CODE
#undef CALIB_MALFORMED
};

const Entry& entry(ErrorCode code) { return table[static_cast<std::size_t>(code)]; }

}  // namespace

std::string_view to_string(ErrorCode code) { return entry(code).word; }

bool is_malformed(ErrorCode code) { return entry(code).malformed; }

std::optional<ErrorCode> parse_error_code(std::string_view word) {
  const auto found = std::ranges::find(all_error_codes, word, [](ErrorCode code) { return to_string(code); });
  return found == all_error_codes.end() ? std::nullopt : std::optional(*found);
}

}  // namespace calib
