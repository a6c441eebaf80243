#include "json_fields.hpp"

#include <array>
#include <charconv>
#include <cmath>

namespace calib::json_fields {
namespace {

void append_number(double value, std::string& out) {
  if (!std::isfinite(value)) {
    out += "null";
    return;
  }
  std::array<char, 64> text;
  const auto write = [&](std::chars_format format) {
    return std::string_view(text.data(),
                            std::to_chars(text.data(), text.data() + text.size(), value, format).ptr - text.data());
  };
  const std::string_view scientific = write(std::chars_format::scientific);
  int exponent = 0;
  const char* const digits = scientific.data() + scientific.find('e') + 1;
  std::from_chars(*digits == '+' ? digits + 1 : digits, scientific.data() + scientific.size(), exponent);
  if (exponent < -4 || exponent >= 16) {
    out += scientific;
    return;
  }
  const std::string_view fixed = write(std::chars_format::fixed);
  out += fixed;
  if (fixed.find('.') == std::string_view::npos) out += ".0";
}

void append(const nlohmann::json& json, std::string& out) {
  const char* separator = "";
  if (json.is_object()) {
    out += '{';
    for (const auto& [key, value] : json.items()) {
      out.append(separator).append(nlohmann::json(key).dump()) += ':';
      append(value, out);
      separator = ",";
    }
    out += '}';
  } else if (json.is_array()) {
    out += '[';
    for (const auto& value : json) {
      out += separator;
      append(value, out);
      separator = ",";
    }
    out += ']';
  } else if (json.is_number_float()) {
    append_number(json.get<double>(), out);
  } else {
    out += json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  }
}

}  // namespace

std::string canonical_text(const nlohmann::json& json) {
  std::string out;
  append(json, out);
  return out;
}

RigidTransform transform_from(const nlohmann::json& json) {
  const auto t = vector_from<3>(json.at("translation_m"));
  const auto q = vector_from<4>(json.at("quaternion_xyzw"));
  const auto transform = make_transform({t[0], t[1], t[2]}, {q[0], q[1], q[2], q[3]});
  if (!transform) throw std::invalid_argument(transform.error().context);
  return *transform;
}

}  // namespace calib::json_fields
