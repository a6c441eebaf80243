#include "model_file.hpp"

#include <cstdint>
#include <filesystem>
#include <fstream>

#include "calib/sha256.hpp"

namespace calib {
namespace {

constexpr std::uintmax_t max_bytes = 1 << 30;

/// The messages of onnx.proto in which tensors lie, and by which of their fields they lead to one another.
enum class Message { model, graph, node, attribute, tensor, sparse_tensor, function, training };
struct Field {
  Message in;
  std::uint64_t number;
  Message holds;
};
constexpr Field fields[] = {
    {Message::model, 7, Message::graph},
    {Message::model, 20, Message::training},
    {Message::model, 25, Message::function},
    {Message::training, 1, Message::graph},
    {Message::training, 2, Message::graph},
    {Message::function, 7, Message::node},
    {Message::function, 11, Message::attribute},
    {Message::graph, 1, Message::node},
    {Message::graph, 5, Message::tensor},
    {Message::graph, 15, Message::sparse_tensor},
    {Message::node, 5, Message::attribute},
    {Message::attribute, 5, Message::tensor},
    {Message::attribute, 6, Message::graph},
    {Message::attribute, 10, Message::tensor},
    {Message::attribute, 11, Message::graph},
    {Message::attribute, 22, Message::sparse_tensor},
    {Message::attribute, 23, Message::sparse_tensor},
    {Message::sparse_tensor, 1, Message::tensor},
    {Message::sparse_tensor, 2, Message::tensor},
};
constexpr std::uint64_t tensor_external_data = 13, tensor_data_location = 14;
constexpr std::string_view inside("\0", 1);

/// Takes a varint off the front of `bytes`.
std::optional<std::uint64_t> take_varint(std::string_view& bytes) {
  std::uint64_t value = 0;
  for (int shift = 0; shift < 64 && !bytes.empty(); shift += 7) {
    const auto byte = static_cast<std::uint8_t>(bytes.front());
    bytes.remove_prefix(1);
    value |= std::uint64_t{byte & 0x7fU} << shift;
    if (byte < 0x80) return value;
  }
  return std::nullopt;
}

/// Takes the content of a field off the front of `bytes`.
std::optional<std::string_view> take_content(std::string_view& bytes, std::uint64_t wire_type) {
  const std::string_view before = bytes;
  std::uint64_t length = 0;
  if (wire_type == 0 || wire_type == 2) {
    const auto number = take_varint(bytes);
    if (!number) return std::nullopt;
    if (wire_type == 0) return before.substr(0, before.size() - bytes.size());
    length = *number;
  } else if (wire_type == 1 || wire_type == 5) {
    length = wire_type == 1 ? 8 : 4;
  } else {
    return std::nullopt;  // groups, which ONNX has none of
  }
  if (length > bytes.size()) return std::nullopt;
  const std::string_view content = bytes.substr(0, length);
  bytes.remove_prefix(length);
  return content;
}

std::optional<bool> scan(Message message, std::string_view bytes, int depth) {
  constexpr int deepest = 100;  // as far as protobuf's own reader goes
  if (depth > deepest) return std::nullopt;
  while (!bytes.empty()) {
    const auto key = take_varint(bytes);
    if (!key) return std::nullopt;
    const std::uint64_t number = *key >> 3, wire_type = *key & 7;
    const auto content = take_content(bytes, wire_type);
    if (!content) return std::nullopt;
    // Exporters also write down the location of what is inside, as 0.
    const bool elsewhere = number == tensor_external_data || (number == tensor_data_location && *content != inside);
    if (message == Message::tensor && elsewhere) return true;
    if (wire_type != 2) continue;
    for (const Field& field : fields) {
      if (field.in != message || field.number != number) continue;
      if (const auto found = scan(field.holds, *content, depth + 1); !found || *found) return found;
    }
  }
  return false;
}

}  // namespace

std::optional<bool> has_external_data(std::string_view bytes) { return scan(Message::model, bytes, 0); }

Result<std::string> read_model_file(const DepthModel& model) {
  const std::string file = model.file.string(), descriptor = model.descriptor.string();
  std::error_code error;
  std::ifstream in;
  if (std::filesystem::is_regular_file(model.file, error)) in.open(model.file, std::ios::binary);
  const std::uintmax_t size = std::filesystem::file_size(model.file, error);
  if (!in.is_open() || error)
    return fail("depth_failed", file + ": cannot be read; put the network there that " + descriptor + " describes");
  if (size > max_bytes) return fail("depth_failed", file + ": is larger than 1 GiB; use a smaller network");
  std::string bytes(size, '\0');
  in.read(bytes.data(), static_cast<std::streamsize>(size));
  if (const std::string sha256 = sha256_hex(bytes); !in || sha256 != model.sha256)
    return fail("depth_failed", file + ": its SHA-256 is " + sha256 + " where " + descriptor + " pins " + model.sha256 +
                                    "; put the pinned network back, or pin this one when it is the one you mean");
  const auto external = has_external_data(bytes);
  if (!external) return fail("depth_failed", file + ": is not an ONNX model; export the network to ONNX");
  if (*external)
    return fail("depth_failed", file +
                                    ": keeps its weights in other files; export the network as one file, without "
                                    "external data");
  return bytes;
}

}  // namespace calib
