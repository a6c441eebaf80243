#include "config_yaml.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <yaml-cpp/eventhandler.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <set>
#include <sstream>

namespace calib {
namespace {

template <typename Number>
std::optional<Number> parse_number(std::string_view text) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

struct Unit {
  std::string_view name;
  double seconds;
};
constexpr std::array units{Unit{"ms", 1e-3}, Unit{"min", 60}, Unit{"s", 1}, Unit{"h", 3600}};

std::string in_words(std::chrono::nanoseconds duration) {
  return fmt::format("{:g}s", std::chrono::duration<double>(duration).count());
}

/// Counts documents as they are parsed.
struct DocumentCount : YAML::EventHandler {
  int count = 0;
  void OnDocumentStart(const YAML::Mark&) override { ++count; }
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark&, YAML::anchor_t) override {}
  void OnAlias(const YAML::Mark&, YAML::anchor_t) override {}
  void OnScalar(const YAML::Mark&, const std::string&, YAML::anchor_t, const std::string&) override {}
  void OnSequenceStart(const YAML::Mark&, const std::string&, YAML::anchor_t,
                       YAML::EmitterStyle::value) override {}
  void OnSequenceEnd() override {}
  void OnMapStart(const YAML::Mark&, const std::string&, YAML::anchor_t, YAML::EmitterStyle::value) override {
  }
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

void ConfigNode::refuse(std::string_view what) const {
  throw BadConfig{line_, key_.empty() ? std::string(what) : fmt::format("{}: {}", key_, what)};
}

const ConfigNode& ConfigNode::with_keys(std::initializer_list<std::string_view> allowed) const {
  const std::string known = fmt::format("{}", fmt::join(allowed, ", "));
  if (!node_.IsMap()) refuse("needs a mapping with the keys " + known);
  std::set<std::string> seen;
  for (const auto& entry : node_) {
    if (!entry.first.IsScalar()) refuse("holds a key that is no word; known keys are " + known);
    const std::string& name = entry.first.Scalar();
    const ConfigNode child(entry.second, key_.empty() ? name : key_ + "." + name,
                           entry.first.Mark().line + 1);
    if (std::ranges::find(allowed, name) == allowed.end())
      child.refuse("unknown key; known keys are " + known);
    if (!seen.insert(name).second) child.refuse("given twice; remove one");
  }
  return *this;
}

std::optional<ConfigNode> ConfigNode::find(std::string_view key) const {
  for (const auto& entry : node_)
    if (entry.first.Scalar() == key)
      return ConfigNode(entry.second, key_.empty() ? std::string(key) : fmt::format("{}.{}", key_, key),
                        entry.first.Mark().line + 1);
  return std::nullopt;
}

ConfigNode ConfigNode::at(std::string_view key) const {
  auto child = find(key);
  if (!child)
    ConfigNode(node_, key_.empty() ? std::string(key) : fmt::format("{}.{}", key_, key), line_)
        .refuse("missing; add it");
  return *child;
}

std::vector<ConfigNode> ConfigNode::items() const {
  if (!node_.IsSequence()) refuse("needs a list");
  std::vector<ConfigNode> items;
  for (std::size_t i = 0; i < node_.size(); ++i)
    items.push_back({node_[i], fmt::format("{}[{}]", key_, i), node_[i].Mark().line + 1});
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
  if (!node_.IsScalar() || node_.Tag() != "?") refuse(fmt::format("needs {}", needed));
  return node_.Scalar();
}

double ConfigNode::number(double min, double max) const {
  const auto value = parse_number<double>(plain_scalar("a number"));
  if (!value || !std::isfinite(*value)) refuse("needs a number");
  if (*value < min || *value > max) refuse(fmt::format("{:g} is outside {:g} .. {:g}", *value, min, max));
  return *value;
}

int ConfigNode::integer(int min, int max) const {
  const auto value = parse_number<std::int64_t>(plain_scalar("a whole number"));
  if (!value) refuse("needs a whole number");
  if (*value < min || *value > max) refuse(fmt::format("{} is outside {} .. {}", *value, min, max));
  return static_cast<int>(*value);
}

std::vector<double> ConfigNode::numbers(std::size_t count, double min, double max) const {
  if (!node_.IsSequence() || node_.size() != count) refuse(fmt::format("needs a list of {} numbers", count));
  std::vector<double> values;
  for (const ConfigNode& item : items()) values.push_back(item.number(min, max));
  return values;
}

std::chrono::nanoseconds ConfigNode::duration(std::chrono::nanoseconds min,
                                              std::chrono::nanoseconds max) const {
  constexpr std::string_view needed = "a duration such as 500ms, 10s or 2min";
  if (!node_.IsScalar()) refuse(fmt::format("needs {}", needed));
  const std::string& text = node_.Scalar();
  const auto unit = std::ranges::find_if(units, [&](const Unit& u) { return text.ends_with(u.name); });
  if (unit == units.end()) refuse(fmt::format("needs {}", needed));
  const auto value = parse_number<double>(std::string_view(text).substr(0, text.size() - unit->name.size()));
  if (!value || !std::isfinite(*value)) refuse(fmt::format("needs {}", needed));
  const std::chrono::duration<double> seconds(*value * unit->seconds);
  if (seconds < min || seconds > max)  // before the conversion, which 1e300h would overflow
    refuse(fmt::format("{} is outside {} .. {}", text, in_words(min), in_words(max)));
  return std::chrono::round<std::chrono::nanoseconds>(seconds);
}

}  // namespace calib
