#include <cstdio>
#include <fstream>
#include <iterator>
#include <random>

#include "fuzz/fuzz.hpp"

namespace {

using calib::fuzz::Octets;

/// A few random changes: bits, edge values, pieces cut out or repeated. The same seed gives the same input.
Octets mutated(Octets bytes, std::mt19937& random) {
  const auto below = [&](std::size_t limit) {
    return std::uniform_int_distribution<std::size_t>(0, limit - 1)(random);
  };
  for (std::size_t changes = 1 + below(4); changes > 0 && !bytes.empty(); --changes) {
    const std::size_t at = below(bytes.size()), length = std::min(1 + below(16), bytes.size() - at);
    const auto from = bytes.begin() + static_cast<std::ptrdiff_t>(at),
               to = from + static_cast<std::ptrdiff_t>(length);
    switch (below(5)) {
      case 0:
        *from ^= static_cast<std::uint8_t>(1U << below(8));
        break;
      case 1:
        *from = static_cast<std::uint8_t>(random());
        break;
      case 2:
        std::fill(from, std::min(to, from + 4), below(2) == 0 ? 0xFF : 0x00);
        break;
      case 3:
        bytes.erase(from, to);
        break;
      default: {
        const Octets piece(from, to);
        bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(below(bytes.size())), piece.begin(),
                     piece.end());
      }
    }
  }
  return bytes;
}

}  // namespace

/// With files: runs each (to look into what a fuzzer found). Without: the seed, then 10000 mutations of it,
/// every other one a mutation of the one before.
int main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    std::ifstream file(argv[i], std::ios::binary);
    if (!file) {
      std::fprintf(stderr, "%s: cannot be read\n", argv[i]);
      return 1;
    }
    const Octets bytes{std::istreambuf_iterator<char>(file), {}};
    LLVMFuzzerTestOneInput(bytes.data(), bytes.size());
  }
  if (argc > 1) return 0;

  const Octets seed = calib::fuzz::seed();
  LLVMFuzzerTestOneInput(seed.data(), seed.size());
  std::mt19937 random(20260131);
  Octets input = seed;
  for (int i = 0; i < 10'000; ++i) {
    input = mutated(i % 2 == 0 ? seed : input, random);
    LLVMFuzzerTestOneInput(input.data(), input.size());
  }
  return 0;
}
