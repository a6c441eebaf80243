#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "calib/record.hpp"
#include "calib/signature.hpp"

namespace calib::test {

/// Whether the vehicle's key signed an event, as proto/feed.md says it is checked: with the signature cut out.
inline bool is_signed(std::string text, const PublicKey& key) {
  nlohmann::json event = nlohmann::json::parse(text);
  const std::string signature = event["signature"];
  event.erase("signature");
  const std::string cut = R"("signature":")" + signature + R"(",)";
  const auto at = text.find(cut);
  if (at == std::string::npos || canonical_json(event) != text.erase(at, cut.size())) return false;
  // `verify_signature` wants the second signature too, which an event does without: only the first is of interest.
  const auto checked = verify_signature(
      text, "untrusted comment: \n" + signature + "\ntrusted comment: \n" + std::string(86, 'A') + "==\n", key);
  return !checked && checked.error().context.find("trusted comment") != std::string::npos;
}

}  // namespace calib::test
