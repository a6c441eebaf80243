#include <cstdio>
#include <fstream>
#include <string_view>

#include "fuzz/fuzz.hpp"

namespace calib::fuzz {

void write_seeds(const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  int number = 0;
  for (const Octets& seed : seeds()) {
    std::ofstream out(folder / ("seed-" + std::to_string(number++)), std::ios::binary);
    out.write(reinterpret_cast<const char*>(seed.data()), static_cast<std::streamsize>(seed.size()));
    require(static_cast<bool>(out.flush()));
  }
}

}  // namespace calib::fuzz

/// libFuzzer calls it first; so every program has the option `--write-seeds FOLDER`.
extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
  if (*argc != 3 || std::string_view((*argv)[1]) != "--write-seeds") return 0;
  calib::fuzz::write_seeds((*argv)[2]);
  std::exit(0);
}
