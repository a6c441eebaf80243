#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <fstream>
#include <iostream>

#include "calib/json_integer.hpp"
#include "calib/record.hpp"
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

/// Who has logged in, whatever sudo has made of them since. calibd believes its kernel first.
json login() {
  constexpr std::uint32_t unset = static_cast<std::uint32_t>(-1);
  std::ifstream file("/proc/self/loginuid");
  std::uint32_t uid = unset;
  return file >> uid && uid != unset ? json(uid) : json();
}

Result<void> add_comment(json& question, const std::string& comment) {
  if (comment.empty()) return {};
  question["comment"] = comment;
  question["login"] = login();
  return check_comment(comment);
}

/// Whether the answer is yes: what `--json` prints is the answer itself.
Result<bool> is_yes(const json& reply) {
  if (!reply.contains("answer")) return fail(ErrorCode::malformed_reply, "the answer does not say what was decided");
  return reply["answer"] != "rejected" && reply.value("would", json()) != "rejected";
}

Exit request(const Paths& paths, const std::string& pair, json question, const std::string& comment, bool as_json) {
  question["schema"] = 1;
  question["pair"] = pair;
  if (const auto added = add_comment(question, comment); !added) return print_error(added.error());
  const auto reply = ask(paths.socket, question, recalibration_timeout, show_waiting);
  clear_waiting();
  if (!reply) return print_error(reply.error());
  if (as_json) std::cout << json_text(*reply, 2);
  const auto yes = as_json ? is_yes(*reply) : show_answer(*reply, pair);
  if (!yes) return print_error(yes.error());
  return *yes ? Exit::done : Exit::no;
}

}  // namespace

Exit recalibrate(const Paths& paths, const std::string& pair, bool dry_run, const std::string& comment, bool as_json) {
  return request(paths, pair, {{"request", "recalibrate"}, {"dry_run", dry_run}}, comment, as_json);
}

Exit accept(const Paths& paths, const std::string& pair, const std::string& comment, bool as_json) {
  return request(paths, pair, {{"request", "accept"}}, comment, as_json);
}

Exit roll_back(const Paths& paths, const std::string& pair, std::optional<std::uint64_t> to, const std::string& comment,
               bool as_json) {
  return request(paths, pair, {{"request", "rollback"}, {"to", to ? json(*to) : json()}}, comment, as_json);
}

Exit rotate_key(const Paths& paths, const KeyOptions& options) {
  json question{{"schema", 1},
                {"request", "rotate_key"},
                {"lost", options.lost},
                {"doubted_from", options.doubted_from ? json(*options.doubted_from) : json()},
                {"login", login()}};
  if (const auto added = add_comment(question, options.comment); !added) return print_error(added.error());
  const std::string file = escape_control(options.file.string());
  int key = -1;
  if (!options.lost) {
    // Read here first, for an error that names the file. The secret itself goes to calibd as an open file.
    if (const auto readable = SigningKey::load(options.file); !readable) return print_error(readable.error());
    key = ::open(options.file.c_str(), O_RDONLY | O_CLOEXEC);
    if (key < 0) return print_error({ErrorCode::bad_key, options.file.string() + ": " + std::strerror(errno)});
  }
  const auto reply = ask(paths.socket, question, recalibration_timeout, show_waiting, key);
  if (key >= 0) ::close(key);
  clear_waiting();
  if (!reply) return print_error(reply.error());
  if (options.json) {
    std::cout << json_text(*reply, 2);
    return Exit::done;
  }
  try {
    std::cout << "Record " << integer_from<std::uint64_t>(reply->at("record")) << ": "
              << escape_control(reply->at("reason").get<std::string>()) << '\n';
  } catch (const std::exception& error) {
    return print_error(
        {ErrorCode::malformed_reply, std::string("calibd answered in a form that is not understood: ") + error.what()});
  }
  if (!options.lost)
    std::cout
        << "calibd signs with it from now on. Before calibd is started again, put the file in the place of the key "
           "before it:\n  mv "
        << file << " /etc/calibd/signing.key\n";
  std::cout << "Records verify with the public key of any key " << (options.lost ? "from this one on" : "of the chain")
            << (options.doubted_from || options.lost
                    ? "; give this one's public key to everybody who verifies,\nin the "
                      "place of the one before it\n"
                    : "\n");
  return Exit::done;
}

}  // namespace calib::ctl
