#include <iostream>

#include "calib/json_integer.hpp"
#include "commands.hpp"
#include "control_client.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;

constexpr std::chrono::minutes recalibration_timeout{10};

std::string score_words(const json& score, const char* before, const char* after) {
  return decimals(score.at(before).get<double>(), 5) + " before, " + decimals(score.at(after).get<double>(), 5) +
         " after";
}

void result_lines(Text& text, const json& result) {
  const json& change = result.at("change");
  Vector6 moved;
  for (int i = 0; i < 3; ++i) {
    moved[i] = change.at("rotation_deg").at(i).get<double>() * radians_per_degree;
    moved[i + 3] = change.at("translation_cm").at(i).get<double>() / 100;
  }
  text.line("LiDAR has moved", "");
  text.motion(moved, nullptr);
  if (!result.contains("score")) return;
  text.line("Score", score_words(result.at("score"), "before", "after"));
  text.line("Held back", score_words(result.at("score"), "held_back_before", "held_back_after"));
}

/// Prints the answer, and returns whether it is positive.
Result<bool> show_answer(const json& reply, const std::string& pair) {
  try {
    const std::string answer = reply.at("answer").get<std::string>();
    const bool dry_run = answer == "dry_run";
    const std::string verdict = dry_run ? reply.at("would").get<std::string>() : answer;
    Text text(terminal_has_colours());
    text.line("Pair", pair);
    text.line("Answer",
              dry_run                    ? "would be " + verdict + " (dry run, nothing was changed)"
              : verdict == "rolled_back" ? "rolled back"
                                         : verdict,
              verdict == "rejected" ? Colour::yellow : Colour::green);
    text.line("Reason", reply.at("reason").get<std::string>());
    if (const json& record = reply.at("record"); !record.is_null())
      text.line("Record", std::to_string(integer_from<std::uint64_t>(record)));
    if (reply.contains("result")) result_lines(text, reply.at("result"));
    std::cout << text.str();
    return verdict != "rejected";
  } catch (const std::exception& error) {
    return fail(ErrorCode::malformed_reply,
                std::string("calibd answered in a form that is not understood: ") + error.what());
  }
}

/// Whether the answer is yes: what `--json` prints is the answer itself.
Result<bool> is_yes(const json& reply) {
  if (!reply.contains("answer")) return fail(ErrorCode::malformed_reply, "the answer does not say what was decided");
  return reply["answer"] != "rejected" && reply.value("would", json()) != "rejected";
}

Exit request(const Paths& paths, const std::string& pair, json question, bool as_json) {
  question["schema"] = 1;
  question["pair"] = pair;
  const auto reply = ask(paths.socket, question, recalibration_timeout, show_waiting);
  clear_waiting();
  if (!reply) return print_error(reply.error());
  if (as_json) std::cout << json_text(*reply, 2);
  const auto yes = as_json ? is_yes(*reply) : show_answer(*reply, pair);
  if (!yes) return print_error(yes.error());
  return *yes ? Exit::done : Exit::no;
}

}  // namespace

Exit recalibrate(const Paths& paths, const std::string& pair, bool dry_run, bool as_json) {
  return request(paths, pair, {{"request", "recalibrate"}, {"dry_run", dry_run}}, as_json);
}

Exit accept(const Paths& paths, const std::string& pair, bool as_json) {
  return request(paths, pair, {{"request", "accept"}}, as_json);
}

Exit roll_back(const Paths& paths, const std::string& pair, std::optional<std::uint64_t> to, bool as_json) {
  return request(paths, pair, {{"request", "rollback"}, {"to", to ? json(*to) : json()}}, as_json);
}

}  // namespace calib::ctl
