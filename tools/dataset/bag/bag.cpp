#include "dataset/bag/bag.hpp"

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cctype>

#include "calib/file.hpp"
#include "dataset/extension.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

struct Files {
  std::vector<fs::path> paths;
  std::vector<std::string> remarks;
};

bool is_bag_file(const fs::path& path) {
  const std::string last = extension_of(path);
  const std::string extension = last == ".zstd" || last == ".zst" ? extension_of(path.stem()) : last;
  return extension == ".mcap" || extension == ".db3";
}

/// `drive_2` comes before `drive_10`.
bool by_number(const fs::path& a, const fs::path& b) {
  const std::string x = a.filename().string(), y = b.filename().string();
  std::size_t i = 0, j = 0;
  const auto is_digit = [](char c) { return std::isdigit(static_cast<unsigned char>(c)) != 0; };
  while (i < x.size() && j < y.size()) {
    if (!is_digit(x[i]) || !is_digit(y[j])) {
      if (x[i] != y[j]) return x[i] < y[j];
      ++i, ++j;
      continue;
    }
    const auto number = [&](const std::string& text, std::size_t& at) {
      while (at + 1 < text.size() && text[at] == '0' && is_digit(text[at + 1])) ++at;
      const std::size_t begin = at;
      while (at < text.size() && is_digit(text[at])) ++at;
      return text.substr(begin, at - begin);
    };
    const std::string m = number(x, i), n = number(y, j);
    if (m != n) return m.size() != n.size() ? m.size() < n.size() : m < n;
  }
  return x.size() - i < y.size() - j;
}

bool is_same(const BagTopic& a, const BagTopic& b) {
  return a.name == b.name && a.type == b.type && a.encoding == b.encoding;
}

Files files_in(const fs::path& folder) {
  Files files;
  std::error_code error;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error))
    if (is_bag_file(entry->path())) files.paths.push_back(entry->path());
  std::ranges::sort(files.paths, by_number);
  return files;
}

/// What metadata.yaml names, as far as it can be read and the files are there.
Files files_of(const fs::path& folder) {
  constexpr std::uint64_t most_bytes = 2 << 20;
  Files files;
  const fs::path metadata = folder / "metadata.yaml";
  const auto unusable = [&](const std::string& why) {
    files = files_in(folder);
    files.remarks.push_back(metadata.string() + " " + why + ": all files of the folder are read");
    return files;
  };
  std::error_code error;
  if (!fs::exists(metadata, error)) return files_in(folder);
  const auto text = read_regular_file(metadata, most_bytes);
  if (!text) return unusable("cannot be read");
  try {
    const YAML::Node listed = YAML::Load(*text)["rosbag2_bagfile_information"]["relative_file_paths"];
    for (const auto& entry : listed) {
      const fs::path path = folder / fs::path(entry.as<std::string>()).filename();
      if (fs::exists(path, error))
        files.paths.push_back(path);
      else
        files.remarks.push_back(path.string() + ", which metadata.yaml names, is not there");
    }
  } catch (const YAML::Exception& what) {
    return unusable("is damaged (" + escape_control(what.msg) + ")");
  }
  if (files.paths.empty()) return unusable("names no file that is there");
  return files;
}

}  // namespace

Result<Bag> Bag::open(const fs::path& given) {
  std::error_code error;
  const fs::path path = given.filename() == "metadata.yaml" ? fs::absolute(given, error).parent_path() : given;
  if (!fs::exists(path, error))
    return fail(ErrorCode::recording_not_found, path.string() +
                                                    " does not exist; --root is a folder of rosbag2, or a "
                                                    "file in it");
  const bool is_folder = fs::is_directory(path, error);
  Files files = is_folder ? files_of(path) : Files{{path}, {}};
  if (files.paths.empty())
    return fail(ErrorCode::recording_not_found, path.string() + " holds no recording (.mcap or .db3)");
  Bag bag;
  bag.remarks_ = std::move(files.remarks);
  for (const fs::path& file : files.paths) {
    auto storage = open_bag_storage(file);
    if (!storage && files.paths.size() == 1) return propagate(storage);
    if (!storage) {
      bag.remarks_.push_back(storage.error().context);
      continue;
    }
    bag.remarks_.insert(bag.remarks_.end(), (*storage)->remarks().begin(), (*storage)->remarks().end());
    bag.files_.emplace_back(*std::move(storage));
  }
  if (bag.files_.empty()) return fail(ErrorCode::file_unreadable, bag.remarks_.front());
  for (const auto& file : bag.files_)
    for (const BagTopic& topic : file->topics()) {
      const auto known =
          std::ranges::find_if(bag.topics_, [&](const BagTopic& other) { return is_same(other, topic); });
      if (known == bag.topics_.end())
        bag.topics_.push_back(topic);
      else
        known->messages += topic.messages;
    }
  std::ranges::sort(bag.topics_, {}, &BagTopic::name);
  return bag;
}

Bag::Messages Bag::messages(const BagTopic& topic) const {
  Messages messages;
  for (std::uint32_t file = 0; file < files_.size(); ++file) {
    const auto& topics = files_[file]->topics();
    const auto wanted = std::ranges::find_if(topics, [&](const BagTopic& other) { return is_same(other, topic); });
    const auto number = static_cast<std::uint32_t>(wanted - topics.begin());
    for (const BagMessage& message : files_[file]->messages())
      if (message.topic == number) messages.push_back({file, message});
  }
  return messages;
}

Result<Octets> Bag::read(const Message& message) const { return files_[message.file]->read(message.place); }

}  // namespace calib
