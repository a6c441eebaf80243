#include "calib/config_node.hpp"

#include <yaml-cpp/eventhandler.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <map>
#include <set>
#include <sstream>

#include "calib/file.hpp"

namespace calib {
namespace {

constexpr std::size_t max_bytes = 1 << 20;
constexpr const char* too_large = "is larger than 1 MiB";

template <typename Number>
std::optional<Number> parse_number(std::string_view text) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

struct Unit {
  std::string_view name;
  double ns;
};
constexpr std::array units{Unit{"ms", 1e6}, Unit{"min", 6e10}, Unit{"s", 1e9}, Unit{"h", 3.6e12}};

/// As %g writes it, whatever the locale is.
std::string in_words(double number) {
  std::array<char, 32> text;
  return {text.data(), std::to_chars(text.begin(), text.end(), number, std::chars_format::general, 6).ptr};
}

std::string in_words(std::chrono::nanoseconds duration) {
  return in_words(std::chrono::duration<double>(duration).count()) + "s";
}

/// Counts documents as they are parsed.
struct DocumentCount : YAML::EventHandler {
  int count = 0;
  void OnDocumentStart(const YAML::Mark&) override { ++count; }
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark&, YAML::anchor_t) override {}
  void OnAlias(const YAML::Mark&, YAML::anchor_t) override {}
  void OnScalar(const YAML::Mark&, const std::string&, YAML::anchor_t, const std::string&) override {}
  void OnSequenceStart(const YAML::Mark&, const std::string&, YAML::anchor_t, YAML::EmitterStyle::value) override {}
  void OnSequenceEnd() override {}
  void OnMapStart(const YAML::Mark&, const std::string&, YAML::anchor_t, YAML::EmitterStyle::value) override {}
  void OnMapEnd() override {}
};

/// Not YAML::LoadAll, which finds documents in a lone `,` or `]` until the memory is full.
bool holds_one_document(const std::string& yaml) {
  std::istringstream in(yaml);
  YAML::Parser parser(in);
  DocumentCount documents;
  while (documents.count < 2 && parser.HandleNextDocument(documents)) {
  }
  return documents.count == 1;
}

std::string canonical_text(const YAML::Node& node) {
  if (node.IsScalar()) return '"' + node.Scalar() + '"';
  std::string text;
  if (node.IsSequence())
    for (const auto& item : node) text += canonical_text(item) + ',';
  if (!node.IsMap()) return '[' + text + ']';
  std::map<std::string, std::string> sorted;
  for (const auto& entry : node) sorted.emplace(entry.first.Scalar(), canonical_text(entry.second));
  for (const auto& [key, value] : sorted) text += key + ':' + value + ',';
  return '{' + text + '}';
}

void add_values(const YAML::Node& node, const std::string& key, std::map<std::string, std::string>& values) {
  const bool is_list =
      node.IsSequence() && std::ranges::any_of(node, [](const auto& item) { return !item.IsScalar(); });
  if (node.IsMap()) {
    for (const auto& entry : node)
      add_values(entry.second, (key.empty() ? "" : key + ".") + entry.first.Scalar(), values);
  } else if (is_list) {
    for (std::size_t i = 0; i < node.size(); ++i) add_values(node[i], key + '[' + std::to_string(i) + ']', values);
  } else {
    values[key] = canonical_text(node);
  }
}

bool holds_control(std::string_view text) {
  return std::ranges::any_of(text, [](char c) { return static_cast<unsigned char>(c) < ' ' || c == 0x7F; });
}

}  // namespace

ConfigNode::ConfigNode(YAML::Node node, std::string key, int line)
    : node_(std::move(node)), key_(std::move(key)), line_(line) {}

ConfigNode ConfigNode::parse(const std::string& yaml) {
  if (!holds_one_document(yaml)) throw BadConfig{1, "the file must hold one YAML document"};
  YAML::Node top = YAML::Load(yaml);
  const int line = std::max(top.Mark().line, 0) + 1;
  return {std::move(top), "", line};
}

std::string ConfigNode::key_of(std::string_view child) const {
  return (key_.empty() ? "" : key_ + ".") + std::string(child);
}

void ConfigNode::refuse(std::string_view what) const {
  throw BadConfig{line_, (key_.empty() ? "" : key_ + ": ") + std::string(what)};
}

const ConfigNode& ConfigNode::with_keys(std::initializer_list<std::string_view> allowed) const {
  std::string known;
  for (const std::string_view name : allowed) known.append(known.empty() ? "" : ", ").append(name);
  if (!node_.IsMap()) refuse("needs a mapping with the keys " + known);
  std::set<std::string> seen;
  for (const auto& entry : node_) {
    if (!entry.first.IsScalar()) refuse("holds a key that is no word; known keys are " + known);
    const std::string& name = entry.first.Scalar();
    const ConfigNode child(entry.second, key_of(name), entry.first.Mark().line + 1);
    if (std::ranges::find(allowed, name) == allowed.end()) child.refuse("unknown key; known keys are " + known);
    if (!seen.insert(name).second) child.refuse("given twice; remove one");
  }
  return *this;
}

std::optional<ConfigNode> ConfigNode::find(std::string_view key) const {
  if (!node_.IsMap()) refuse("needs a mapping");
  for (const auto& entry : node_)
    if (entry.first.Scalar() == key) return ConfigNode(entry.second, key_of(key), entry.first.Mark().line + 1);
  return std::nullopt;
}

ConfigNode ConfigNode::at(std::string_view key) const {
  auto child = find(key);
  if (!child) ConfigNode(node_, key_of(key), line_).refuse("missing; add it");
  return *child;
}

std::string ConfigNode::canonical() const { return canonical_text(node_); }

std::map<std::string, std::string> ConfigNode::values() const {
  std::map<std::string, std::string> values;
  add_values(node_, key_, values);
  return values;
}

std::vector<std::pair<std::string, ConfigNode>> ConfigNode::entries() const {
  if (!node_.IsMap()) refuse("needs a mapping");
  std::vector<std::pair<std::string, ConfigNode>> entries;
  std::set<std::string> seen;
  for (const auto& entry : node_) {
    if (!entry.first.IsScalar()) refuse("holds a key that is no word");
    const std::string& name = entry.first.Scalar();
    ConfigNode child(entry.second, key_of(name), entry.first.Mark().line + 1);
    if (!seen.insert(name).second) child.refuse("given twice; remove one");
    entries.emplace_back(name, std::move(child));
  }
  return entries;
}

std::vector<ConfigNode> ConfigNode::items() const {
  if (!node_.IsSequence()) refuse("needs a list");
  std::vector<ConfigNode> items;
  for (std::size_t i = 0; i < node_.size(); ++i)
    items.push_back({node_[i], key_ + "[" + std::to_string(i) + "]", node_[i].Mark().line + 1});
  return items;
}

std::string ConfigNode::text() const {
  if (!node_.IsScalar()) refuse("needs text");
  const std::string& text = node_.Scalar();
  if (text.empty() || text.size() > 4096 || holds_control(text))
    refuse("needs text of 1 .. 4096 characters without control characters");
  return text;
}

/// Quoted, a number is text: yaml-cpp marks that with the tag `!`.
std::string ConfigNode::plain_scalar(std::string_view needed) const {
  if (!node_.IsScalar() || node_.Tag() != "?") refuse("needs " + std::string(needed));
  return node_.Scalar();
}

double ConfigNode::number(double min, double max) const {
  const auto value = parse_number<double>(plain_scalar("a number"));
  if (!value || !std::isfinite(*value)) refuse("needs a number");
  if (*value < min || *value > max) refuse(in_words(*value) + " is outside " + in_words(min) + " .. " + in_words(max));
  return *value;
}

int ConfigNode::integer(int min, int max) const {
  const auto value = parse_number<std::int64_t>(plain_scalar("a whole number"));
  if (!value) refuse("needs a whole number");
  if (*value < min || *value > max)
    refuse(std::to_string(*value) + " is outside " + std::to_string(min) + " .. " + std::to_string(max));
  return static_cast<int>(*value);
}

bool ConfigNode::boolean() const {
  const std::string text = plain_scalar("true or false");
  if (text != "true" && text != "false") refuse("needs true or false");
  return text == "true";
}

std::vector<double> ConfigNode::numbers(std::size_t count, double min, double max) const {
  if (!node_.IsSequence() || node_.size() != count) refuse("needs a list of " + std::to_string(count) + " numbers");
  std::vector<double> values;
  for (const ConfigNode& item : items()) values.push_back(item.number(min, max));
  return values;
}

std::chrono::nanoseconds ConfigNode::duration(std::chrono::nanoseconds min, std::chrono::nanoseconds max) const {
  constexpr std::string_view needed = "a duration such as 500ms, 10s or 2min";
  if (!node_.IsScalar()) refuse("needs " + std::string(needed));
  const std::string& text = node_.Scalar();
  const auto unit = std::ranges::find_if(units, [&](const Unit& u) { return text.ends_with(u.name); });
  if (unit == units.end()) refuse("needs " + std::string(needed));
  const auto value = parse_number<double>(std::string_view(text).substr(0, text.size() - unit->name.size()));
  if (!value || !std::isfinite(*value)) refuse("needs " + std::string(needed));
  // Whole nanoseconds are compared, as 1.9s is no double. What is far beyond any of them would overflow.
  constexpr double longest_ns = 9e18;
  const double ns = *value * unit->ns;
  const std::chrono::nanoseconds duration(std::llround(std::clamp(ns, -longest_ns, longest_ns)));
  if (duration < min || duration > max) refuse(text + " is outside " + in_words(min) + " .. " + in_words(max));
  return duration;
}

Result<void> parse_config_text(std::string_view yaml, const std::filesystem::path& file,
                               const std::function<void(const ConfigNode&)>& read) {
  const auto refuse = [&](int line, const std::string& message) {
    return fail(ErrorCode::bad_config, file.string() + ":" + std::to_string(line) + ": " + message);
  };
  if (yaml.size() > max_bytes) return refuse(1, too_large);
  try {
    read(ConfigNode::parse(std::string(yaml)));
    return {};
  } catch (const BadConfig& bad) {
    return refuse(bad.line, bad.message);
  } catch (const YAML::Exception& e) {
    return refuse(std::max(e.mark.line, 0) + 1, "not YAML: " + e.msg);
  }
}

Result<std::string> read_config_text(const std::filesystem::path& file) {
  auto text = read_regular_file(file, max_bytes);
  if (!text && text.error().code == ErrorCode::file_too_large)
    return fail(ErrorCode::bad_config, file.string() + ":1: " + too_large);
  if (!text) return fail(ErrorCode::config_not_found, text.error().context);
  return text;
}

}  // namespace calib
