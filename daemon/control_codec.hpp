#pragma once

#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "calib/signature.hpp"
#include "calib/status.hpp"
#include "calib/store.hpp"
#include "config_reload.hpp"
#include "diagnosis.hpp"
#include "pair_pipeline.hpp"

namespace calib {

// What is asked at the control socket, and answered, as proto/control.md has it. This is the only place that writes or
// reads its JSON.

struct StatusRequest {};
/// Records from number `from` on.
struct RecordsRequest {
  std::uint64_t from = 1;
};
/// Of one pair, or of all.
struct DiagnosisRequest {
  std::optional<std::string> pair;
};
/// What a person says beside a request, checked, and the login as the person's program has it.
struct Said {
  std::string comment;
  std::optional<std::uint64_t> login{};
};
struct RecalibrationRequest {
  std::string pair;
  bool dry_run = false;
  Said said{};
};
/// The configuration, anew from its file.
struct ReloadRequest {};
struct AcceptRequest {
  std::string pair;
  Said said{};
};
/// To the extrinsic of record `to`, or to the one before the present one.
struct RollbackRequest {
  std::string pair;
  std::optional<std::uint64_t> to;
  Said said{};
};
/// The next key comes as a file along with the request, unless the one before it is lost.
struct KeyRequest {
  bool lost = false;
  std::optional<std::uint64_t> doubted_from{};
  Said said{};
};
/// Events of the outbox with a sequence above `after`, `limit` at most. With `wait`, the reply waits for the first one.
struct FeedRequest {
  std::uint64_t after = 0;
  std::size_t limit = most_events;
  bool wait = false;
  static constexpr std::size_t most_events = 200;
};
/// Events up to and including number `through`, of the page of `run`, were received.
struct AcknowledgeRequest {
  std::uint64_t through = 0;
  std::string run;
};
using ControlRequest =
    std::variant<StatusRequest, RecordsRequest, DiagnosisRequest, RecalibrationRequest, AcceptRequest, RollbackRequest,
                 ReloadRequest, KeyRequest, FeedRequest, AcknowledgeRequest>;

/// Whether a request is answered at once: it changes nothing and waits for nothing.
[[nodiscard]] bool only_shows(const ControlRequest& request);

/// Some of the store's records, both texts empty where one is missing.
struct RecordsPage {
  std::uint64_t stored = 0;
  std::vector<SignedRecord> records;
};
/// Some of the events that wait, and how many do. `run` is another after each start of calibd: the store may be another
/// one then, with other events of the same numbers.
struct FeedPage {
  std::string vehicle, run;
  std::uint64_t waiting = 0;
  std::vector<Store::Event> events;
};
struct Acknowledged {
  std::uint64_t waiting = 0;
};
/// An `Error` has one of the codes `bad_request`, `not_found`, `not_ready`, `denied`, `wrong_key` and `failed`.
using ControlReply =
    std::variant<Error, Status, RecordsPage, DiagnosisReport, Answer, ConfigChanges, FeedPage, Acknowledged>;

/// A request as `parse_request` lets it pass. Fails with `bad_request`.
[[nodiscard]] Result<ControlRequest> decode_request(const nlohmann::json& request);
[[nodiscard]] nlohmann::json encode_reply(const ControlReply& reply);

}  // namespace calib
