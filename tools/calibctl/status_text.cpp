#include "status_text.hpp"

#include <cmath>

#include "calib/axis_words.hpp"
#include "text.hpp"

namespace calib::ctl {
Colour colour_of(Verdict verdict) {
  switch (verdict) {
    case Verdict::calibrated:
      return Colour::green;
    case Verdict::drifted:
      return Colour::red;
    case Verdict::suspect:
    case Verdict::not_evaluated:
      break;
  }
  return Colour::yellow;
}

std::string words_of(Verdict verdict) {
  return verdict == Verdict::not_evaluated ? "not evaluated" : std::string(to_string(verdict));
}

namespace {

/// In the largest of s, min, h and days of which there are two.
std::string in_unit(double seconds, int decimal_places, const char* days) {
  if (seconds < 120) return decimals(seconds, decimal_places) + " s";
  if (seconds < 2 * 3600) return decimals(seconds / 60, decimal_places) + " min";
  if (seconds < 2 * 86400) return decimals(seconds / 3600, decimal_places) + " h";
  return decimals(seconds / 86400, decimal_places) + days;
}

}  // namespace

std::string duration(double seconds) { return in_unit(seconds, 1, " days"); }

std::string short_duration(double seconds) { return in_unit(seconds, seconds < 10 ? 1 : 0, " d"); }

double seconds_between(WallTime from, WallTime to) {
  using Seconds = std::chrono::duration<double>;
  return (Seconds(to) - Seconds(from)).count();
}

namespace {

std::string skipped_words(const PairStatus& pair) {
  std::uint64_t total = 0;
  std::string reasons;
  for (const auto& [reason, count] : pair.skipped) {
    total += count;
    reasons += (reasons.empty() ? " (" : ", ") + reason + ' ' + std::to_string(count);
  }
  return std::to_string(total) + reasons + (reasons.empty() ? "" : ")");
}

void input_line(Text& text, std::string_view label, const PairStatus::Input& input) {
  text.wrapped(label, input.topic + (input.age_s ? ", " + duration(*input.age_s) + " ago" : ", never seen"));
}

void record_lines(Text& text, const PairStatus::Record& record, const RecordCheck& check) {
  const Colour colour = check.verified ? Colour::none : Colour::red;
  const std::string made =
      std::to_string(record.sequence) + " of " + rfc3339(record.created) + ", key " + record.key_id;
  if (check.checked && check.verified) return text.wrapped("Record", made + ", verified");
  text.wrapped("Record", made, colour);
  if (check.checked)
    text.wrapped("", "NOT VERIFIED: " + check.words, colour);
  else
    text.wrapped("", (check.verified ? "verified by calibd, " : "NOT VERIFIED, ") + check.words, colour);
}

void pair_lines(Text& text, const PairStatus& pair, const RecordCheck& check, WallTime now) {
  text.blank();
  text.line("Pair", pair.name);
  text.line("Verdict", words_of(pair.verdict), colour_of(pair.verdict));
  text.line("Since", rfc3339(pair.since) + " (" + duration(seconds_between(pair.since, now)) + " ago)");
  text.parts("Reason", pair.reason);
  if (pair.notice)
    text.line("Would notice", decimals(pair.notice->rotation_rad / radians_per_degree, 2) +
                                  " degrees about any axis after " + duration(pair.notice->driving_s) + " of driving");
  text.line(
      "Evaluated",
      counted(pair.evaluated, "pair") +
          (pair.last_evaluated ? ", the last " + duration(seconds_between(*pair.last_evaluated, now)) + " ago" : ""));
  text.wrapped("Skipped", skipped_words(pair));
  for (const auto& [code, remark] : pair.remarks)
    text.wrapped("Remark", remark.text + " (" + code + ", " + counted(remark.count, "time") + ')');
  if (pair.score)
    text.line("Score", decimals(pair.score->current, 5) + " (best neighbour " +
                           decimals(pair.score->best_neighbour, 5) +
                           (pair.score->baseline ? ", baseline " + decimals(*pair.score->baseline, 5) : "") + ")");
  if (!pair.misalignment) {
    const bool drifts = pair.verdict == Verdict::suspect || pair.verdict == Verdict::drifted;
    if (drifts) text.line("LiDAR has moved", "not estimated yet");
  } else {
    text.line("LiDAR has moved", "");
    for (int axis = 0; axis < 6; ++axis) {
      std::string words = axis_in_words(pair, axis);
      if (pair.detection_limit && std::isfinite((*pair.detection_limit)[axis]))
        words += "; detection limit " + amount_in_words(axis, (*pair.detection_limit)[axis]);
      text.line(axis_label(axis), words);
    }
  }
  text.transform("Extrinsic", pair.T_camera_lidar);
  if (pair.proposed) {
    text.transform("Proposed", pair.proposed->T_camera_lidar);
    text.wrapped("", "record " + std::to_string(pair.proposed->record_sequence) +
                         ", not in force; to put it in force: calibctl accept " + pair.name);
  }
  if (pair.record)
    record_lines(text, *pair.record, check);
  else
    text.line("Record", "none");
  input_line(text, "Image", pair.image);
  if (pair.right_image) input_line(text, "Right image", *pair.right_image);
  if (pair.depth) input_line(text, "Depth", *pair.depth);
  if (pair.motion) input_line(text, "Motion", *pair.motion);
  input_line(text, "Cloud", pair.cloud);
  if (pair.time_difference_ms)
    text.line("Time difference", decimals(std::abs(*pair.time_difference_ms), 1) + " ms, cloud " +
                                     (*pair.time_difference_ms < 0 ? "before" : "after") + " image");
}

}  // namespace

std::string head_text(const Status& status, std::optional<double> snapshot_age_s, bool coloured) {
  Text text(coloured);
  text.line("Vehicle", status.vehicle);
  if (snapshot_age_s)
    text.line("Daemon", "NOT RUNNING; this is its last snapshot, " + duration(*snapshot_age_s) + " old", Colour::red);
  else
    text.line("Daemon", "running for " + duration(status.uptime_s) + ", version " + status.version);
  text.line("Alerts waiting", std::to_string(status.feed_queued));
  if (status.signing_refused) text.wrapped("SIGNING", "REFUSED: " + *status.signing_refused, Colour::red);
  if (status.records_missing) text.wrapped("RECORDS MISSING", *status.records_missing, Colour::red);
  return text.str();
}

std::string status_text(const Status& status, const std::vector<RecordCheck>& checks, WallTime now,
                        std::optional<double> snapshot_age_s, bool coloured) {
  Text text(coloured);
  for (std::size_t i = 0; i < status.pairs.size(); ++i) pair_lines(text, status.pairs[i], checks[i], now);
  return head_text(status, snapshot_age_s, coloured) + text.str();
}

}  // namespace calib::ctl
