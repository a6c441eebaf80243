#include "model_file.hpp"

#include <onnxruntime_cxx_api.h>

#include <cstdint>
#include "support/catch.hpp"

using namespace calib;

namespace {

// Protocol buffers by hand, so that they can be written as no library writes them.

std::string varint(std::uint64_t value, std::size_t least_bytes = 1) {
  std::string bytes;
  for (; value >= 0x80 || bytes.size() + 1 < least_bytes; value >>= 7) bytes += static_cast<char>(value | 0x80);
  return bytes + static_cast<char>(value);
}

std::string tag(std::uint64_t field, std::uint64_t wire_type) { return varint(field << 3 | wire_type); }
std::string number(std::uint64_t field, std::uint64_t value) { return tag(field, 0) + varint(value); }
std::string bytes(std::uint64_t field, const std::string& content) {
  return tag(field, 2) + varint(content.size()) + content;
}

/// y = x + w, of one number each. `where` is the end of the tensor w.
std::string model_with(const std::string& where) {
  const std::string one = bytes(2, bytes(1, number(1, 1) + bytes(2, bytes(1, number(1, 1)))));
  const std::string node = bytes(1, "x") + bytes(1, "w") + bytes(2, "y") + bytes(4, "Add");
  const std::string weight = number(1, 1) + number(2, 1) + bytes(8, "w") + where;
  const std::string graph = bytes(1, node) + bytes(2, "graph") + bytes(5, weight) + bytes(11, bytes(1, "x") + one) +
                            bytes(12, bytes(1, "y") + one);
  return number(1, 8) + bytes(8, number(2, 17)) + bytes(7, graph);
}

const std::string inside = bytes(9, std::string(4, '\0'));
const std::string location = bytes(1, "location") + bytes(2, "another_file");

/// What ONNX Runtime says of a model; nothing when it loads it.
std::string loaded(const std::string& model) {
  Ort::InitApi();
  static const Ort::Env env(ORT_LOGGING_LEVEL_FATAL, "test");
  try {
    const Ort::Session session(env, model.data(), model.size(), Ort::SessionOptions());
    return "";
  } catch (const Ort::Exception& exception) {
    return exception.what();
  }
}

/// Beyond 32 bits: protobuf cuts that off, and reads `field`.
std::string long_tag(std::uint64_t field, std::uint64_t wire_type) {
  return varint(std::uint64_t{1} << 32 | field << 3 | wire_type);
}

}  // namespace

TEST_CASE("a model that keeps its weights inside is let through, and ONNX Runtime loads it") {
  for (const std::string& where : {inside, inside + number(14, 0), inside + tag(13 + 16, 5) + "four"}) {
    CHECK(has_external_data(model_with(where)) == std::optional(false));
    CHECK(loaded(model_with(where)).empty());
  }
}

TEST_CASE("weights in another file are found as every protobuf library writes them") {
  for (const std::string& where : {bytes(13, location) + number(14, 1), number(14, 1) + bytes(13, location),
                                   number(14, 1), bytes(13, location), inside + tag(14, 0) + varint(1, 10)})
    CHECK(has_external_data(model_with(where)) == std::optional(true));
}

TEST_CASE("weights in another file are not hidden by how fields are written") {
  const std::string data_location = number(14, 1);
  const struct {
    const char* what;
    std::string where;
  } tricks[] = {
      {"tags of 33 bits", long_tag(13, 2) + varint(location.size()) + location + long_tag(14, 0) + varint(1)},
      {"one tag of 33 bits", bytes(13, location) + long_tag(14, 0) + varint(1)},
      {"tags with further bits",
       varint(std::uint64_t{7} << 32 | 13 << 3 | 2) + varint(location.size()) + location + long_tag(14, 0) + varint(1)},
      {"longer tags than needed",
       varint(13 << 3 | 2, 5) + varint(location.size()) + location + varint(14 << 3, 4) + varint(1)},
      {"tags of six bytes",
       varint(13 << 3 | 2, 6) + varint(location.size()) + location + varint(14 << 3, 6) + varint(1)},
      {"tags of ten bytes",
       varint(13 << 3 | 2, 10) + varint(location.size()) + location + varint(14 << 3, 10) + varint(1)},
      {"a length longer than needed", tag(13, 2) + varint(location.size(), 5) + location + data_location},
      {"a length of six bytes", tag(13, 2) + varint(location.size(), 6) + location + data_location},
      {"a length beyond 32 bits",
       tag(13, 2) + varint(std::uint64_t{1} << 32 | location.size()) + location + data_location},
      {"a number beyond 32 bits", bytes(13, location) + tag(14, 0) + varint(std::uint64_t{1} << 32 | 1)},
      {"a number longer than needed", bytes(13, location) + tag(14, 0) + varint(1, 10)},
      {"a number of eleven bytes", bytes(13, location) + tag(14, 0) + varint(1, 11)},
      {"in a group", tag(20, 3) + bytes(13, location) + data_location + tag(20, 4)},
      {"behind an end of group", inside + tag(20, 4) + bytes(13, location) + data_location},
      {"behind field 0", inside + varint(0) + bytes(13, location) + data_location},
      {"behind field 0 with a content", inside + bytes(0, "") + bytes(13, location) + data_location},
      {"behind wire type 6", inside + tag(20, 6) + bytes(13, location) + data_location},
      {"behind wire type 7", inside + tag(20, 7) + bytes(13, location) + data_location},
      {"behind a field that ends with the tensor", inside + tag(20, 2) + varint(location.size() + 100)},
      {"cut off", bytes(13, location) + tag(14, 0) + "\x81"},
  };
  for (const auto& [what, where] : tricks) {
    INFO(what << ": ONNX Runtime says " << loaded(model_with(where)));
    CHECK(has_external_data(model_with(where)) != std::optional(false));
  }
  // The tensor itself, under such a tag.
  const std::string tensor = number(1, 1) + number(2, 1) + bytes(8, "w") + bytes(13, location) + data_location;
  const std::string graph = long_tag(5, 2) + varint(tensor.size()) + tensor;
  CHECK(has_external_data(bytes(7, graph)) == std::nullopt);
  CHECK(has_external_data(long_tag(7, 2) + varint(0)) == std::nullopt);
}

TEST_CASE("a model that nests deeper than protobuf reads is none") {
  std::string graph = "";
  for (int i = 0; i < 60; ++i) graph = bytes(1, bytes(5, bytes(6, graph)));
  CHECK(has_external_data(bytes(7, graph)) == std::nullopt);
  CHECK(loaded(bytes(7, graph)).find("parsing failed") != std::string::npos);
}
