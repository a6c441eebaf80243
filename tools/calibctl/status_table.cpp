#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "calib/axis_words.hpp"
#include "status_text.hpp"
#include "table.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

/// Axis whose displacement is the most standard deviations, of those that the scenes show.
std::optional<int> worst_axis(const PairStatus& pair) {
  std::optional<int> worst;
  double most = -1;
  for (int axis = 0; axis < 6; ++axis) {
    const double sigma = pair.misalignment->sigma[axis];
    if (!std::isfinite(sigma) || (pair.detection_limit && !std::isfinite((*pair.detection_limit)[axis]))) continue;
    const double deviations =
        std::abs(pair.misalignment->delta[axis]) / std::max(sigma, std::numeric_limits<double>::min());
    if (deviations > most) worst = axis, most = deviations;
  }
  return worst;
}

/// `yaw 0.62 +- 0.05 deg to the left`.
std::string worst_axis_words(const PairStatus& pair) {
  const bool drifts = pair.verdict == Verdict::suspect || pair.verdict == Verdict::drifted;
  if (!pair.misalignment) return drifts ? "not estimated yet" : "-";
  const auto axis = worst_axis(pair);
  if (!axis) return "not observable";
  const double delta = pair.misalignment->delta[*axis];
  std::string side = motion_in_words(*axis, delta);  // `0.62 degrees to the left`
  side.erase(0, side.find(' '));
  constexpr std::string_view degrees = " degrees";
  if (side.starts_with(degrees)) side.replace(0, degrees.size(), " deg");
  return std::string(axis_names[static_cast<std::size_t>(*axis)]) + ' ' + amount_in_words(*axis, delta) + " +- " +
         amount_in_words(*axis, pair.misalignment->sigma[*axis]) + side;
}

std::string record_words(const PairStatus& pair, const RecordCheck& check) {
  if (!pair.record) return "none";
  return std::to_string(pair.record->sequence) + (check.checked && check.verified ? " verified"
                                                  : check.verified                ? " by calibd"
                                                                                  : " UNVERIFIED");
}

/// Of the older of image and cloud.
std::string data_age(const PairStatus& pair, double snapshot_age_s) {
  if (!pair.image.age_s || !pair.cloud.age_s) return "never";
  return short_duration(std::max(*pair.image.age_s, *pair.cloud.age_s) + snapshot_age_s);
}

/// What an operator has to know beside the row, a line each.
void notes_of(std::string& notes, const PairStatus& pair, const RecordCheck& check) {
  const auto note = [&](const std::string& words) {
    notes += cut(escape_control(pair.name + ": " + words), Text::max_width) + '\n';
  };
  if (pair.verdict != Verdict::calibrated) note(pair.reason);
  if (pair.record && !check.verified) note("record NOT VERIFIED: " + check.words);
  if (pair.proposed)
    note("record " + std::to_string(pair.proposed->record_sequence) +
         " is proposed, not in force; to put it in force: calibctl accept " + pair.name);
}

}  // namespace

std::string status_table(const Status& status, const std::vector<RecordCheck>& checks, WallTime now,
                         std::optional<double> snapshot_age_s, bool coloured) {
  Table table({"PAIR", "VERDICT", "SINCE", "WORST AXIS", "RECORD", "DATA AGE"}, coloured);
  std::string notes;
  for (std::size_t i = 0; i < status.pairs.size(); ++i) {
    const PairStatus& pair = status.pairs[i];
    table.row({{pair.name},
               {words_of(pair.verdict), colour_of(pair.verdict)},
               {short_duration(seconds_between(pair.since, now))},
               {worst_axis_words(pair)},
               {record_words(pair, checks[i]), checks[i].verified ? Colour::none : Colour::red},
               {data_age(pair, snapshot_age_s.value_or(0))}});
    notes_of(notes, pair, checks[i]);
  }
  return head_text(status, snapshot_age_s, coloured) + '\n' + table.str() + (notes.empty() ? "" : '\n' + notes);
}

}  // namespace calib::ctl
