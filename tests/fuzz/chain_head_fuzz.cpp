#include "chain_head.hpp"

#include <nlohmann/json.hpp>

#include "fuzz/fuzz.hpp"
#include "fuzz/scratch.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  const std::string sha256(64, 'a');
  return {octets(R"({"missing":null,"schema":1,"sequence":7,"sha256":")" + sha256 + R"("})"),
          octets(R"({"mac":"0","missing":"record 3","schema":1,"sequence":7,"sha256":")" + sha256 + R"("})")};
}

}  // namespace calib::fuzz

/// Without our key nothing is taken; so what is an object is tried with its right code too. What is taken then can be
/// written, and is the same when it is read again.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  using namespace calib::fuzz;
  static const calib::SigningKey key = calib::SigningKey::generate();
  const auto read = [](std::string_view file) {
    (void)scratch().write("chain-head.json", file);
    auto head = calib::read_chain_head(scratch().folder(), &key);
    if (!head) require_code(head.error(), {calib::ErrorCode::malformed_head});
    return head;
  };
  require(!read(text(bytes, size)));
  auto object = nlohmann::json::parse(bytes, bytes + size, nullptr, /*allow_exceptions=*/false);
  if (!object.is_object()) return 0;
  object.erase("mac");
  object.erase("next_mac");
  object["mac"] = key.mac("calibd chain head", object.dump());
  const auto head = read(object.dump());
  if (!head) return 0;
  require(head->has_value() && calib::write_chain_head(scratch().folder(), **head, key).has_value());
  const auto again = calib::read_chain_head(scratch().folder(), &key);
  require(again.has_value() && (*again)->sequence == (*head)->sequence && (*again)->sha256 == (*head)->sha256 &&
          (*again)->missing == (*head)->missing);
  return 0;
}
