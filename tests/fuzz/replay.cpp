#include <csignal>
#include <cstdio>
#include <fstream>
#include <iterator>
#include <random>

#include "fuzz/fuzz.hpp"

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/common_interface_defs.h>

/// GCC's UBSan is a library of its own, which does not know of AddressSanitizer's callback.
extern "C" const char* __ubsan_default_options() { return "abort_on_error=1"; }
#endif

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv);

namespace {

using calib::fuzz::Octets;
namespace fs = std::filesystem;

constexpr int mutations = 10'000;

/// A few random changes: bits, edge values, pieces cut out or repeated. The same seed gives the same input.
Octets mutated(Octets bytes, std::mt19937& random) {
  const auto below = [&](std::size_t limit) {
    return std::uniform_int_distribution<std::size_t>(0, limit - 1)(random);
  };
  for (std::size_t changes = 1 + below(4); changes > 0 && !bytes.empty(); --changes) {
    const std::size_t at = below(bytes.size()), length = std::min(1 + below(16), bytes.size() - at);
    const auto from = bytes.begin() + static_cast<std::ptrdiff_t>(at), to = from + static_cast<std::ptrdiff_t>(length);
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
        bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(below(bytes.size())), piece.begin(), piece.end());
      }
    }
  }
  return bytes;
}

const Octets* running = nullptr;
fs::path failed_input;

/// Keeps the input that ends the program.
void keep_input() {
  if (running == nullptr) return;
  std::ofstream(failed_input, std::ios::binary)
      .write(reinterpret_cast<const char*>(running->data()), static_cast<std::streamsize>(running->size()));
  std::fprintf(stderr, "the input is in %s: run this program with it\n", failed_input.c_str());
}

void keep_input_and_end(int signal) {
  keep_input();
  std::signal(signal, SIG_DFL);
  std::raise(signal);
}

void run(const Octets& input) {
  running = &input;
  LLVMFuzzerTestOneInput(input.data(), input.size());
  running = nullptr;
}

bool run_file(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) {
    std::fprintf(stderr, "%s: cannot be read\n", path.c_str());
    return false;
  }
  run({std::istreambuf_iterator<char>(file), {}});
  return true;
}

/// Every other one is a mutation of the one before.
void run_mutations() {
  const std::vector<Octets> seeds = calib::fuzz::seeds();
  for (const Octets& seed : seeds) run(seed);
  std::mt19937 random(20260131);
  Octets input;
  for (std::size_t i = 0; i < mutations; ++i) {
    input = mutated(i % 2 == 0 ? seeds[i / 2 % seeds.size()] : input, random);
    run(input);
  }
}

/// A corpus that is not there would let this test pass with nothing tried.
bool run_corpus(const fs::path& folder) {
  std::size_t files = 0;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (!run_file(entry.path())) return false;
    ++files;
  }
  std::printf("%zu files of %s, %d mutations of the seeds\n", files, folder.c_str(), mutations);
  return files > 0;
}

}  // namespace

/// With files: runs each (to look into what a fuzzer found). With a folder: the seeds, mutations of them, and
/// everything in the folder.
int main(int argc, char** argv) {
  LLVMFuzzerInitialize(&argc, &argv);
  if (argc < 2) {
    std::fprintf(stderr, "usage: %s FOLDER | FILE... | --write-seeds FOLDER\n", argv[0]);
    return 2;
  }
  failed_input = fs::absolute(fs::path(argv[0]).filename() += ".failed-input");
  std::signal(SIGABRT, keep_input_and_end);
#ifdef __SANITIZE_ADDRESS__
  __sanitizer_set_death_callback(keep_input);
#else
  for (const int signal : {SIGSEGV, SIGBUS, SIGFPE, SIGILL}) std::signal(signal, keep_input_and_end);
#endif
  if (argc == 2 && fs::is_directory(argv[1])) {
    run_mutations();
    return run_corpus(argv[1]) ? 0 : 1;
  }
  for (int i = 1; i < argc; ++i)
    if (!run_file(argv[i])) return 1;
  return 0;
}
