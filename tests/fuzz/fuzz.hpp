#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <initializer_list>
#include <string>
#include <string_view>
#include <vector>

#include "calib/result.hpp"

/// One fuzz target: libFuzzer's entry point, and well-formed inputs to start from. Built with clang and
/// -DCALIBD_FUZZ=ON it is a libFuzzer program; otherwise replay.cpp gives it a main() that mutates the seeds.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size);

namespace calib::fuzz {

using Octets = std::vector<std::uint8_t>;
/// At least one, the same ones each time.
[[nodiscard]] std::vector<Octets> seeds();

/// Writes the seeds into `folder` (made where it is missing), one file each.
void write_seeds(const std::filesystem::path& folder);

/// What must hold for every input.
inline void require(bool holds) {
  if (!holds) std::abort();
}

inline void require_code(const Error& error, std::initializer_list<ErrorCode> codes) {
  require(std::ranges::find(codes, error.code) != codes.end());
}

[[nodiscard]] inline Octets octets(std::string_view text) { return {text.begin(), text.end()}; }
[[nodiscard]] inline std::string_view text(const std::uint8_t* bytes, std::size_t size) {
  return {reinterpret_cast<const char*>(bytes), size};
}
[[nodiscard]] inline std::string_view text(const Octets& bytes) { return text(bytes.data(), bytes.size()); }

/// Reads an input from its front; numbers past its end are zero.
class Input {
 public:
  Input(const std::uint8_t* bytes, std::size_t size) : bytes_(bytes, bytes + size) {}
  template <typename Number>
  Number take() {
    Number value{};
    const std::size_t size = std::min(sizeof(Number), bytes_.size() - at_);
    std::copy_n(bytes_.begin() + static_cast<std::ptrdiff_t>(at_), size, reinterpret_cast<std::uint8_t*>(&value));
    at_ += size;
    return value;
  }
  std::string take_text() {
    const std::size_t wanted = take<std::uint8_t>(), size = std::min(wanted, bytes_.size() - at_);
    const std::string text(bytes_.begin() + at_, bytes_.begin() + at_ + size);
    at_ += size;
    return text;
  }
  [[nodiscard]] Octets rest() const { return {bytes_.begin() + at_, bytes_.end()}; }

 private:
  Octets bytes_;
  std::size_t at_ = 0;
};

/// The inverse of `Input`.
class Output {
 public:
  template <typename Number>
  Output& put(const Number& value) {
    const auto* bytes = reinterpret_cast<const std::uint8_t*>(&value);
    bytes_.insert(bytes_.end(), bytes, bytes + sizeof(value));
    return *this;
  }
  Output& put_text(const std::string& text) {
    put(static_cast<std::uint8_t>(text.size()));
    bytes_.insert(bytes_.end(), text.begin(), text.end());
    return *this;
  }
  [[nodiscard]] Octets with(const Octets& rest) {
    bytes_.insert(bytes_.end(), rest.begin(), rest.end());
    return bytes_;
  }

 private:
  Octets bytes_;
};

}  // namespace calib::fuzz
