#include "model_file.hpp"

#include <cstdint>

#include "calib/file.hpp"
#include "calib/sha256.hpp"

namespace calib {
namespace {

constexpr std::uint64_t max_bytes = 1 << 30;

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

/// Takes a varint of at most `longest` bytes off the front of `bytes`.
std::optional<std::uint64_t> take_varint(std::string_view& bytes, int longest) {
  std::uint64_t value = 0;
  for (int shift = 0; shift < 7 * longest && !bytes.empty(); shift += 7) {
    const auto byte = static_cast<std::uint8_t>(bytes.front());
    bytes.remove_prefix(1);
    value |= std::uint64_t{byte & 0x7fU} << shift;
    if (byte < 0x80) return value;
  }
  return std::nullopt;
}

// What protobuf's own reader takes: longer ones are an error to it. It cuts a tag's bits off behind the 32nd, so that a
// field with more of them would be another one to it than to a reader that keeps them.
constexpr int longest_tag = 5, longest_length = 5, longest_value = 10;
constexpr std::uint64_t largest_tag = 0xffff'ffff;

struct Tag {
  std::uint64_t field, wire_type;
};

std::optional<Tag> take_tag(std::string_view& bytes) {
  const auto tag = take_varint(bytes, longest_tag);
  if (!tag || *tag > largest_tag || *tag >> 3 == 0) return std::nullopt;
  return Tag{*tag >> 3, *tag & 7};
}

/// Takes the content of a field off the front of `bytes`.
std::optional<std::string_view> take_content(std::string_view& bytes, std::uint64_t wire_type) {
  const std::string_view before = bytes;
  std::uint64_t length = 0;
  if (wire_type == 0 || wire_type == 2) {
    const auto number = take_varint(bytes, wire_type == 0 ? longest_value : longest_length);
    if (!number) return std::nullopt;
    if (wire_type == 0) return before.substr(0, before.size() - bytes.size());
    length = *number;
  } else if (wire_type == 1 || wire_type == 5) {
    length = wire_type == 1 ? 8 : 4;
  } else {
    return std::nullopt;  // groups, which ONNX has none of, and types that there are not
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
    const auto tag = take_tag(bytes);
    if (!tag) return std::nullopt;
    const auto& [number, wire_type] = *tag;
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
  auto bytes = read_regular_file(model.file, max_bytes);
  if (!bytes && bytes.error().code == ErrorCode::file_too_large)
    return fail(ErrorCode::depth_failed, file + ": is larger than 1 GiB; use a smaller network");
  if (!bytes)
    return fail(ErrorCode::depth_failed,
                bytes.error().context + "; put the network there that " + descriptor + " describes");
  if (const std::string sha256 = sha256_hex(*bytes); sha256 != model.sha256)
    return fail(ErrorCode::depth_failed,
                file + ": its SHA-256 is " + sha256 + " where " + descriptor + " pins " + model.sha256 +
                    "; put the pinned network back, or pin this one when it is the one you mean");
  const auto external = has_external_data(*bytes);
  if (!external) return fail(ErrorCode::depth_failed, file + ": is not an ONNX model; export the network to ONNX");
  if (*external)
    return fail(ErrorCode::depth_failed,
                file +
                    ": keeps its weights in other files; export the network as one file, without "
                    "external data");
  return bytes;
}

}  // namespace calib
