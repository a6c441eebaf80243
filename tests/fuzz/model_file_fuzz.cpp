#include "model_file.hpp"

#include "fuzz/fuzz.hpp"

namespace calib::fuzz {

/// A field of bytes in protobuf's encoding, of fewer than 128 bytes.
std::string field(int number, const std::string& content) {
  std::string bytes;
  const int key = number << 3 | 2;
  if (key >= 0x80) bytes += static_cast<char>((key & 0x7F) | 0x80);
  bytes += static_cast<char>(key >= 0x80 ? key >> 7 : key);
  return bytes + static_cast<char>(content.size()) + content;
}

/// model.graph.initializer: a tensor whose data lie in another file.
const std::string elsewhere = field(7, field(5, field(13, field(1, "location") + field(2, "weights.bin"))));

std::vector<Octets> seeds() {
  const std::string tensor = field(8, "weights") + field(9, "\1\2\3\4");
  const std::string attribute = field(5, field(1, "value") + field(5, tensor));
  const std::string node = field(1, field(1, "x") + attribute);
  const std::string inside = field(7, node + field(5, tensor + std::string("\x70\0", 2)) + field(15, field(1, tensor)));
  return {octets(inside), octets(elsewhere),
          octets(inside + field(25, field(7, attribute)) + field(20, field(1, node)))};
}

}  // namespace calib::fuzz

/// Messages one behind another are one message in protobuf: what the first holds must not hide what the second has.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const std::string model(calib::fuzz::text(bytes, size));
  const auto external = calib::has_external_data(model);
  if (!external) return 0;
  calib::fuzz::require(calib::has_external_data(model + model) == external);
  calib::fuzz::require(calib::has_external_data(model + calib::fuzz::elsewhere) == true);
  calib::fuzz::require(calib::has_external_data(calib::fuzz::elsewhere + model) == true);
  return 0;
}
