#include "control_codec.hpp"

#include <nlohmann/json.hpp>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using nlohmann::json;
using test::require_ok;

namespace {

template <typename Request>
Request decoded(const json& request) {
  return std::get<Request>(require_ok(decode_request(request)));
}

}  // namespace

TEST_CASE("each request is read with what belongs to it, and nothing else of it matters") {
  CHECK(std::holds_alternative<StatusRequest>(require_ok(decode_request({{"request", "status"}, {"pair", 7}}))));
  CHECK(decoded<RecordsRequest>({{"request", "records"}, {"from", 5U}}).from == 5);
  CHECK_FALSE(decoded<DiagnosisRequest>({{"request", "doctor"}}).pair);
  CHECK(decoded<DiagnosisRequest>({{"request", "doctor"}, {"pair", "front"}}).pair == "front");
  CHECK(decoded<DiagnosisRequest>({{"request", "doctor"}, {"pair", 7}}).pair == "");  // no pair bears that name
  const auto recalibration =
      decoded<RecalibrationRequest>({{"request", "recalibrate"}, {"pair", "front"}, {"dry_run", true}});
  CHECK((recalibration.pair == "front" && recalibration.dry_run));
  CHECK_FALSE(decoded<RecalibrationRequest>({{"request", "recalibrate"}, {"pair", "front"}}).dry_run);
  CHECK(decoded<AcceptRequest>({{"request", "accept"}, {"pair", "front"}}).pair == "front");
  CHECK(decoded<RollbackRequest>({{"request", "rollback"}, {"pair", "front"}, {"to", 3U}}).to == 3);
  CHECK_FALSE(decoded<RollbackRequest>({{"request", "rollback"}, {"pair", "front"}, {"to", nullptr}}).to);
}

TEST_CASE("requests of the feed are read with what belongs to them") {
  const auto all = decoded<FeedRequest>({{"request", "feed"}});
  CHECK((all.after == 0 && all.limit == FeedRequest::most_events && !all.wait));
  const auto some = decoded<FeedRequest>({{"request", "feed"}, {"after", 7U}, {"limit", 5U}, {"wait", true}});
  CHECK((some.after == 7 && some.limit == 5 && some.wait));
  const auto received = decoded<AcknowledgeRequest>({{"request", "acknowledge"}, {"through", 7U}, {"run", "boot-1"}});
  CHECK((received.through == 7 && received.run == "boot-1"));
  for (const json& request :
       {json{{"request", "feed"}, {"after", -1}}, json{{"request", "feed"}, {"limit", 0U}},
        json{{"request", "feed"}, {"limit", 201U}}, json{{"request", "feed"}, {"limit", "1"}},
        json{{"request", "acknowledge"}, {"through", 7U}}, json{{"request", "acknowledge"}, {"run", "boot-1"}},
        json{{"request", "acknowledge"}, {"through", -7}, {"run", "boot-1"}}}) {
    INFO(request.dump());
    CHECK_FALSE(decode_request(request));
  }
}

TEST_CASE("what a person says comes with a request that leads to a record") {
  const json said{{"pair", "front"}, {"comment", "bracket replaced"}, {"login", 1000U}};
  const auto with = [&](const char* what) {
    json request = said;
    request["request"] = what;
    return request;
  };
  CHECK(decoded<RecalibrationRequest>(with("recalibrate")).said.comment == "bracket replaced");
  CHECK(decoded<AcceptRequest>(with("accept")).said.login == 1000);
  CHECK(decoded<RollbackRequest>(with("rollback")).said.comment == "bracket replaced");
  const auto key = decoded<KeyRequest>({{"request", "rotate_key"}, {"lost", true}, {"doubted_from", 7U}});
  CHECK((key.lost && key.doubted_from == 7 && key.said.comment.empty() && !key.said.login));
  CHECK_FALSE(decoded<KeyRequest>({{"request", "rotate_key"}}).lost);
  for (const json& comment : {json(""), json(7), json("two\nlines"), json(std::string(1001, 'x'))}) {
    json request = with("accept");
    request["comment"] = comment;
    CHECK(decode_request(request).error().code == "bad_request");
  }
  for (const json& request :
       {json{{"request", "rotate_key"}, {"doubted_from", "1"}}, json{{"request", "accept"}, {"login", -1}}})
    CHECK(decode_request(request).error().code == "bad_request");
}

TEST_CASE("what is not a request is refused") {
  for (const json& request :
       {json{{"request", "stop"}}, json{{"request", "records"}}, json{{"request", "records"}, {"from", 0U}},
        json{{"request", "records"}, {"from", -1}}, json{{"request", "records"}, {"from", "1"}},
        json{{"request", "rollback"}, {"pair", "front"}, {"to", "1"}},
        json{{"request", "rollback"}, {"pair", "front"}, {"to", -1}}}) {
    INFO(request.dump());
    const auto refused = decode_request(request);
    REQUIRE_FALSE(refused);
    CHECK(refused.error().code == "bad_request");
  }
}

TEST_CASE("replies have the form of proto/control.md") {
  CHECK(encode_reply(Error{ErrorCode::not_found, "there is no pair 'x'"}) ==
        json{{"ok", false}, {"code", "not_found"}, {"message", "there is no pair 'x'"}});
  CHECK(encode_reply(RecordsPage{.stored = 2, .records = {{"{}", "signature"}, {}}}) ==
        json{{"ok", true},
             {"stored", 2},
             {"records", {{{"canonical", "{}"}, {"signature", "signature"}}, {{"canonical", ""}, {"signature", ""}}}}});
  CHECK(encode_reply(FeedPage{.vehicle = "car",
                              .run = "boot-1",
                              .waiting = 3,
                              .events = {{7, Store::Priority::state, {}, "{}"}, {8, Store::Priority::gap, {}, "x"}}}) ==
        json{{"ok", true},
             {"vehicle", "car"},
             {"run", "boot-1"},
             {"waiting", 3},
             {"events",
              {{{"sequence", 7}, {"priority", "state"}, {"event", "{}"}},
               {{"sequence", 8}, {"priority", "alert"}, {"event", "x"}}}}});
  CHECK(encode_reply(Acknowledged{.waiting = 2}) == json{{"ok", true}, {"waiting", 2}});
  const json plain = encode_reply(Answer{.decision = Decision::rolled_back, .reason = "back", .record = 4});
  CHECK(plain == json{{"ok", true}, {"answer", "rolled_back"}, {"reason", "back"}, {"record", 4}});

  Recalibration result;
  result.delta = Vector6::Constant(0.01);
  result.score_before = 1;
  result.score_after = 2;
  const json dry =
      encode_reply(Answer{.decision = Decision::proposed, .dry_run = true, .reason = "good", .result = result});
  CHECK(dry["answer"] == "dry_run");
  CHECK(dry["would"] == "accepted");
  CHECK(dry["record"].is_null());
  CHECK(dry["result"]["change"]["translation_cm"] == json{1.0, 1.0, 1.0});
  CHECK(dry["result"]["change"]["rotation_deg"][2].get<double>() == Approx(0.01 / radians_per_degree));
  CHECK(dry["result"]["score"]["after"] == 2);
}
