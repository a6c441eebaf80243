#include <zlib.h>

#include <algorithm>
#include <array>
#include <map>
#include <mutex>
#include <type_traits>
#include <utility>

#include "dataset/bag/bag_storage.hpp"
#include "dataset/bag/decompress.hpp"

namespace calib {
namespace {

/// Names as in the specification, section "Records".
enum class Opcode : std::uint8_t {
  schema = 0x03,
  channel = 0x04,
  message = 0x05,
  chunk = 0x06,
  data_end = 0x0F,
};

/// A record's content, in a source of bytes.
struct Record {
  std::uint8_t opcode = 0;
  std::uint64_t at = 0, size = 0;
};

/// Numbers (little endian) and strings from the front of bytes; once something is missing, nothing more is there.
class Fields {
 public:
  explicit Fields(std::span<const std::uint8_t> bytes) : left_(bytes) {}
  template <typename Number>
  Number take() {
    static_assert(std::is_unsigned_v<Number>);
    Number value = 0;
    good_ = good_ && left_.size() >= sizeof value;
    if (!good_) return 0;
    for (std::size_t i = 0; i < sizeof value; ++i) value |= static_cast<Number>(Number{left_[i]} << (8 * i));
    left_ = left_.subspan(sizeof value);
    return value;
  }
  std::string text() {
    const auto size = take<std::uint32_t>();
    good_ = good_ && left_.size() >= size;
    if (!good_) return {};
    const std::string value(left_.begin(), left_.begin() + size);
    left_ = left_.subspan(size);
    return value;
  }
  [[nodiscard]] bool good() const { return good_; }
  [[nodiscard]] std::size_t left() const { return left_.size(); }

 private:
  std::span<const std::uint8_t> left_;
  bool good_ = true;
};

/// The first bytes of a record, `most` at most: what is asked for stands in front.
Octets front_of(const ByteSource& source, const Record& record, std::uint64_t most) {
  Octets bytes(std::min(record.size, most));
  if (!source.read(record.at, bytes)) bytes.clear();
  return bytes;
}

struct Chunk {
  std::uint64_t at = 0, size = 0, uncompressed_size = 0;  // of the records
  std::uint32_t crc = 0;                                  // of the uncompressed records; 0: not known
  std::string compression;                                // empty, lz4 or zstd
};

class McapFile : public BagStorage {
 public:
  McapFile(std::unique_ptr<ByteSource> file, std::string name) : file_(std::move(file)), name_(std::move(name)) {}

  /// Lists the records of the data section.
  void list_all() {
    constexpr std::uint64_t magic_bytes = 8;
    if (!list_records(*file_, magic_bytes, no_chunk))
      list().remarks.push_back(name_ + " ends early or is damaged: what comes before that is read, which are " +
                               std::to_string(list().messages.size()) + " messages");
    if (damaged_chunks_ > 0)
      list().remarks.push_back(std::to_string(damaged_chunks_) + " of " + std::to_string(chunks_.size()) +
                               " chunks of " + name_ + " are damaged: what can be read of them is");
    if (!unknown_compression_.empty())
      list().remarks.push_back("chunks of " + name_ + " are compressed with '" + unknown_compression_ +
                               "', where lz4 and zstd are known: they are left out");
    if (list().messages.size() >= most_messages)
      list().remarks.push_back("only the first " + std::to_string(most_messages) + " messages of " + name_ +
                               " are read");
  }

  [[nodiscard]] Result<Octets> read(const BagMessage& message) const override {
    const auto unreadable = [this] {
      return fail(ErrorCode::file_unreadable, "a message of " + name_ + " can no longer be read");
    };
    if (message.size > most_bytes) return unreadable();
    Octets bytes(message.size);
    if (message.chunk == no_chunk) {
      if (!file_->read(message.at, bytes)) return unreadable();
    } else if (message.chunk >= chunks_.size() || !open_chunk(message.chunk)->read(message.at, bytes)) {
      return unreadable();
    }
    return plain_message(std::move(bytes), most_bytes, name_);
  }

 private:
  static constexpr std::uint32_t no_chunk = UINT32_MAX;

  /// False when the records end before the section or the source does.
  bool list_records(const ByteSource& source, std::uint64_t offset, std::uint32_t chunk) {
    while (offset < source.size()) {
      std::array<std::uint8_t, 9> header{};
      if (!source.read(offset, header)) return false;
      Fields fields(header);
      Record record{fields.take<std::uint8_t>(), offset + header.size(), fields.take<std::uint64_t>()};
      const bool whole = record.size <= source.size() - record.at;
      const auto opcode = static_cast<Opcode>(record.opcode);
      if (opcode == Opcode::data_end) return true;
      if (!whole && opcode != Opcode::chunk) return false;
      if (!whole) record.size = source.size() - record.at;
      list_record(source, record, chunk);
      if (!whole || list().messages.size() >= most_messages) return whole;
      offset = record.at + record.size;
    }
    return chunk != no_chunk;  // the data section has a record that ends it
  }

  void list_record(const ByteSource& source, const Record& record, std::uint32_t chunk) {
    constexpr std::uint64_t names = 2048;
    switch (static_cast<Opcode>(record.opcode)) {
      case Opcode::schema:
        return add_schema(front_of(source, record, names));
      case Opcode::channel:
        return add_channel(front_of(source, record, names));
      case Opcode::message:
        return add_message(source, record, chunk);
      case Opcode::chunk:
        if (chunk == no_chunk) add_chunk(record);  // there are none within others
        return;
      default:
        return;  // indexes, attachments and what later versions add
    }
  }

  void add_schema(const Octets& content) {
    Fields fields(content);
    const auto id = fields.take<std::uint16_t>();
    std::string name = fields.text();
    if (fields.good() && name.size() <= longest_name) schemas_.try_emplace(id, std::move(name));
  }

  void add_channel(const Octets& content) {
    Fields fields(content);
    const auto id = fields.take<std::uint16_t>(), schema = fields.take<std::uint16_t>();
    BagTopic topic;
    topic.name = fields.text();
    topic.encoding = fields.text();
    const auto type = schemas_.find(schema);
    if (type != schemas_.end()) topic.type = type->second;
    if (!fields.good() || channels_.contains(id)) return;
    if (const auto number = list().add(std::move(topic))) channels_.emplace(id, *number);
  }

  void add_message(const ByteSource& source, const Record& record, std::uint32_t chunk) {
    constexpr std::uint64_t fields_bytes = 22;  // channel id, sequence, log time, publish time
    const Octets content = front_of(source, record, fields_bytes + stamp_bytes);
    if (content.size() < fields_bytes) return;
    const auto channel = channels_.find(Fields(content).take<std::uint16_t>());
    if (channel == channels_.end()) return;
    BagTopic& topic = list().topics[channel->second];
    ++topic.messages;
    if (!topic.is_listed()) return;
    BagMessage message{channel->second, chunk, record.at + fields_bytes, record.size - fields_bytes,
                       BagMessage::no_stamp};
    std::span<const std::uint8_t> head(content.begin() + fields_bytes, content.end());
    if (topic.type != bag_type::transforms) message.stamp = stamp_in(head);
    if (is_zstd(head)) message.stamp = compressed_stamp(source, message);
    list().messages.push_back(message);
  }

  /// Of a message that is compressed by itself.
  static Timestamp compressed_stamp(const ByteSource& source, const BagMessage& message) {
    Octets bytes(std::min(message.size, most_bytes));
    if (!source.read(message.at, bytes)) return BagMessage::no_stamp;
    return stamp_in(decompress_zstd(bytes, stamp_bytes).bytes);
  }

  void add_chunk(const Record& record) {
    const Octets front = front_of(*file_, record, 64);
    Fields fields(front);
    fields.take<std::uint64_t>();  // times of the first and the last message
    fields.take<std::uint64_t>();
    Chunk chunk;
    chunk.uncompressed_size = fields.take<std::uint64_t>();
    chunk.crc = fields.take<std::uint32_t>();
    chunk.compression = fields.text();
    chunk.size = fields.take<std::uint64_t>();
    if (chunks_.size() >= no_chunk - 1) return;
    chunk.at = record.at + front.size() - fields.left();
    const bool whole = fields.good() && chunk.size <= record.at + record.size - chunk.at;
    if (fields.good() && !whole) chunk.size = record.at + record.size - chunk.at;
    chunks_.push_back(chunk);
    if (!fields.good()) {
      ++damaged_chunks_;
      return;
    }
    if (chunk.compression.empty()) {
      const PartOfSource records(*file_, chunk.at, chunk.size);
      damaged_chunks_ += !list_records(records, 0, static_cast<std::uint32_t>(chunks_.size() - 1)) || !whole;
      return;
    }
    if (chunk.compression != "lz4" && chunk.compression != "zstd") {
      unknown_compression_ = escape_control(chunk.compression);
      return;
    }
    bool complete = whole;
    const OctetSource records(decompress(chunk, complete));
    damaged_chunks_ += !list_records(records, 0, static_cast<std::uint32_t>(chunks_.size() - 1)) || !complete;
  }

  /// The records of a compressed chunk, or what is left of them; then `complete` becomes false.
  [[nodiscard]] Octets decompress(const Chunk& chunk, bool& complete) const {
    const std::uint64_t most = std::min(chunk.uncompressed_size, most_bytes);
    Octets bytes(std::min(chunk.size, most_bytes));
    if (!file_->read(chunk.at, bytes)) bytes.clear();
    Decompressed records = chunk.compression == "lz4" ? decompress_lz4(bytes, most) : decompress_zstd(bytes, most);
    complete = complete && records.complete && records.bytes.size() == chunk.uncompressed_size;
    if (complete && chunk.crc != 0) complete = crc(records.bytes) == chunk.crc;
    return std::move(records.bytes);
  }

  static std::uint32_t crc(const Octets& bytes) {
    return static_cast<std::uint32_t>(crc32_z(crc32_z(0, nullptr, 0), bytes.data(), bytes.size()));
  }

  /// The last one is kept: neighbouring messages are often of one chunk.
  [[nodiscard]] std::shared_ptr<const ByteSource> open_chunk(std::uint32_t number) const {
    const Chunk& chunk = chunks_[number];
    if (chunk.compression.empty()) return std::make_shared<PartOfSource>(*file_, chunk.at, chunk.size);
    {
      const std::scoped_lock lock(last_mutex_);
      if (last_ && last_number_ == number) return last_;
    }
    bool ignored = true;
    auto opened = std::make_shared<OctetSource>(decompress(chunk, ignored));
    const std::scoped_lock lock(last_mutex_);
    last_ = opened;
    last_number_ = number;
    return opened;
  }

  std::unique_ptr<ByteSource> file_;
  std::string name_;
  std::map<std::uint16_t, std::string> schemas_;
  std::map<std::uint16_t, std::uint32_t> channels_;  // number of the topic
  std::vector<Chunk> chunks_;
  std::size_t damaged_chunks_ = 0;
  std::string unknown_compression_;
  mutable std::mutex last_mutex_;
  mutable std::shared_ptr<const ByteSource> last_;
  mutable std::uint32_t last_number_ = no_chunk;
};

}  // namespace

Result<std::unique_ptr<BagStorage>> open_mcap(std::unique_ptr<ByteSource> file, const std::string& name) {
  auto mcap = std::make_unique<McapFile>(std::move(file), name);
  mcap->list_all();
  return mcap;
}

}  // namespace calib
