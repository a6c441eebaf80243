#include <algorithm>
#include <cmath>
#include <iostream>
#include <nlohmann/json.hpp>

#include "calib/file.hpp"
#include "commands.hpp"
#include "exported_records.hpp"
#include "stored_records.hpp"
#include "table.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using VerifiedRecord = Chain::Link;

/// Fails if there are no records.
Result<Chain> read_some(const Paths& paths) {
  auto chain = read_chain(paths);
  if (chain && chain->stored == 0 && !chain->broken)
    return fail(ErrorCode::record_not_found, "the store holds no records yet");
  return chain;
}

RigidTransform change(const CalibrationRecord& record) {
  return record.T_camera_lidar_before.inverse() * record.T_camera_lidar;
}

/// `2026-01-31 12:00:00`, UTC.
std::string to_the_second(WallTime time) {
  std::string text = rfc3339(time).substr(0, 19);
  text[10] = ' ';
  return text;
}

/// A row, and below it the reason.
void history_row(Table& table, const CalibrationRecord& record) {
  constexpr std::size_t widest_pair = 18, widest_client = 16;
  const RigidTransform by = change(record);
  table.row({{std::to_string(record.sequence)},
             {to_the_second(record.wall_time)},
             {record.key_change ? "-" : cut(record.pair, widest_pair)},
             {std::string(to_string(record.decision))},
             {record.decision == Decision::baseline || record.key_change
                  ? "-"
                  : decimals(rotation_angle_rad(by) / radians_per_degree, 2) + " deg, " +
                        decimals(by.translation().norm() * 100, 1) + " cm"},
             {cut(record.asked_by, widest_client)}});
  table.detail(record.reason);
  if (!record.comment.text.empty()) table.detail('"' + record.comment.text + '"');
}

nlohmann::json history_json(const Chain& chain, const std::string& pair) {
  auto records = nlohmann::json::array();
  for (const auto& [record, bytes] : chain.verified) {
    if (!pair.empty() && record.pair != pair) continue;
    const Vector6 moved = perturbation_parameters(change(record));
    const auto three = [&](int first, double unit) {
      return nlohmann::json{moved[first] / unit, moved[first + 1] / unit, moved[first + 2] / unit};
    };
    records.push_back({{"sequence", record.sequence},
                       {"decided", rfc3339(record.wall_time)},
                       {"pair", record.pair},
                       {"decision", to_string(record.decision)},
                       {"change", {{"rotation_deg", three(0, radians_per_degree)}, {"translation_cm", three(3, 0.01)}}},
                       {"asked_by", record.asked_by},
                       {"reason", record.reason}});
  }
  return {{"schema", 1},
          {"key", chain.key.id_text()},
          {"stored", chain.stored},
          {"verified", chain.verified.size()},
          {"broken", chain.broken ? nlohmann::json(chain.broken->context) : nlohmann::json()},
          {"records", std::move(records)}};
}

std::string score_words(double before, double after) {
  return decimals(before, 5) + " before, " + decimals(after, 5) + " after";
}

/// Per axis, in degrees and cm: mean and standard deviation of the slope, and its sensitivity to a displacement.
void baseline_lines(Text& text, const CalibrationRecord::Baseline& baseline) {
  text.line("Baseline", "from " + counted(baseline.pairs, "pair") + ", score " + decimals(baseline.score, 5) +
                            ", sigma " + decimals(baseline.score_deviation, 5) + ", above its neighbours by " +
                            decimals(baseline.prominence, 5) + ", sigma " + decimals(baseline.prominence_deviation, 5));
  for (int axis = 0; axis < 6; ++axis) {
    const double unit = axis < 3 ? radians_per_degree : 0.01;
    text.line(axis_label(axis), "slope " + decimals(baseline.slope[axis] * unit, 5) + ", sigma " +
                                    decimals(std::sqrt(baseline.slope_covariance(axis, axis)) * unit, 5) + ", per " +
                                    (axis < 3 ? "degree" : "cm") + "; sensitivity " +
                                    decimals(baseline.sensitivity(axis, axis) * unit * unit, 5) + ", sigma " +
                                    decimals(baseline.sensitivity_deviation[axis] * unit * unit, 5));
  }
}

void key_lines(Text& text, const KeyChange& change) {
  text.line("Key before", change.previous.id_text() + ", public key " + change.previous.text() +
                              (change.previous_lost ? ", lost" : ""));
  text.line("Next key", change.next.id_text() + ", public key " + change.next.text());
  if (change.doubted_from)
    text.line("Doubted", "records of the key before, from " + std::to_string(*change.doubted_from) + " on");
}

std::string record_text(const CalibrationRecord& record, const std::string& key_id) {
  Text text(false);
  text.line("Record", std::to_string(record.sequence) + ", verified, key " + key_id);
  text.line("Vehicle", record.vehicle);
  if (!record.key_change) text.line("Pair", record.pair);
  text.line("Decision", to_string(record.decision));
  text.line("Reason", record.reason);
  text.line("Asked by", record.asked_by + (record.comment.login.empty() ? "" : ", login " + record.comment.login));
  if (!record.comment.text.empty()) text.line("Comment", record.comment.text);
  text.line("Decided", rfc3339(record.wall_time));
  text.line("",
            decimals(std::chrono::duration<double>(record.boot_time).count(), 3) + " s after boot " + record.boot_id);
  if (!record.key_change) text.transform("Extrinsic", record.T_camera_lidar);
  if (record.key_change) {
    key_lines(text, *record.key_change);
  } else if (record.baseline) {
    baseline_lines(text, *record.baseline);
  } else {
    text.transform("Before", record.T_camera_lidar_before);
    text.line("Change", how_far(change(record)));
    const Vector6 moved = perturbation_parameters(change(record));
    text.motion(moved, record.sigma ? &*record.sigma : nullptr);
  }
  if (record.score) {
    text.line("Score", score_words(record.score->before, record.score->after));
    text.line("Held back", score_words(record.score->held_back_before, record.score->held_back_after));
  }
  if (!record.key_change) text.line("Frames", std::to_string(record.frame_stamps_ns.size()));
  text.line("Software", record.software_version + ", SHA-256 " + record.software_sha256);
  text.line("Configuration", "SHA-256 " + record.configuration_sha256);
  text.line("Record before", "SHA-256 " + record.previous_sha256);
  return text.str();
}

/// Never replaces a file. Succeeds if the file exists with these bytes.
Result<void> write_new(const std::filesystem::path& file, std::string_view bytes) {
  std::error_code error;
  const auto there = std::filesystem::symlink_status(file, error).type();
  if (there == std::filesystem::file_type::regular && read_regular_file(file, largest_export) == bytes) return {};
  if (!std::filesystem::exists(std::filesystem::file_status(there))) return replace_file(file, bytes);
  return fail(ErrorCode::file_exists, file.string() +
                                          " exists already and is not this record; it is kept; export into " +
                                          "another folder, or move it away");
}

Result<void> export_record(const VerifiedRecord& shown, const std::filesystem::path& folder) {
  std::error_code error;
  if (is_foreign_link(folder))
    return fail(ErrorCode::export_failed, folder.string() + " is a link that another user created");
  std::filesystem::create_directories(folder, error);
  if (error) return fail(ErrorCode::export_failed, folder.string() + ": " + error.message());
  const std::filesystem::path file = folder / record_file_name(shown.record.sequence);
  if (const auto written = write_new(file, shown.bytes.canonical); !written) return written;
  return write_new(file.string() + ".minisig", shown.bytes.signature);
}

Exit verify_files(const std::vector<std::filesystem::path>& files, const PublicKey& key, bool as_json) {
  auto exported = read_exported(files, key);
  if (!exported) return print_error(exported.error());
  std::vector<VerifiedRecord>& records = *exported;
  if (records.empty()) return print_error({ErrorCode::bad_request, "name at least one exported record, NNNNNN.json"});
  std::ranges::sort(records, {}, [](const VerifiedRecord& record) { return record.record.sequence; });
  std::uint64_t links = 0;
  for (std::size_t i = 1; i < records.size(); ++i) {
    const VerifiedRecord &before = records[i - 1], &after = records[i];
    const std::string numbers =
        std::to_string(before.record.sequence) + " and " + std::to_string(after.record.sequence);
    if (before.record.sequence == after.record.sequence && before.bytes.canonical != after.bytes.canonical)
      return print_error({ErrorCode::broken_chain, "two different records have the number " + numbers});
    if (before.record.sequence + 1 != after.record.sequence) continue;
    if (after.record.previous_sha256 != sha256_hex(before.bytes.canonical))
      return print_error(
          {ErrorCode::broken_chain, "records " + numbers + " are signed, but the second does not continue the first"});
    ++links;
  }
  if (as_json) {
    std::cout << json_text({{"schema", 1}, {"key", key.id_text()}, {"verified", records.size()}, {"links", links}}, 2);
    return Exit::done;
  }
  std::cout << counted(records.size(), "record") << " verified, key " << key.id_text() << "; " << counted(links, "link")
            << " between them checked" << (links + 1 < records.size() ? ", the others are not among these files" : "")
            << '\n';
  return Exit::done;
}

}  // namespace

Exit history(const Paths& paths, const std::string& pair, bool as_json) {
  const auto chain = read_some(paths);
  if (!chain) return print_error(chain.error());
  Table table({"SEQ", "DECIDED (UTC)", "PAIR", "DECISION", "CHANGE", "ASKED BY"}, /*coloured=*/false);
  bool any = false;
  for (const VerifiedRecord& item : chain->verified) {
    if (!pair.empty() && item.record.pair != pair) continue;
    history_row(table, item.record);
    any = true;
  }
  if (any && as_json)
    std::cout << json_text(history_json(*chain, pair), 2);
  else if (any)
    std::cout << table.str();
  if (chain->broken) {
    std::cout << std::flush;
    const Exit exit = print_error(*chain->broken);
    std::cerr << "calibctl: " << counted(chain->stored - chain->verified.size(), "record")
              << " from there on not shown\n";
    return exit;
  }
  return any ? Exit::done : print_error({ErrorCode::record_not_found, "there is no record of a pair '" + pair + "'"});
}

Exit show(const Paths& paths, const ShowOptions& options) {
  const auto chain = read_some(paths);
  if (!chain) return print_error(chain.error());
  const std::uint64_t sequence = options.sequence.value_or(chain->stored);
  if (sequence == 0 || sequence > chain->stored)
    return print_error({ErrorCode::record_not_found, "the store holds records 1 to " + std::to_string(chain->stored)});
  if (sequence > chain->verified.size()) return print_error(*chain->broken);
  const VerifiedRecord& shown = chain->verified[sequence - 1];
  if (!options.export_to.empty()) {
    if (const auto exported = export_record(shown, options.export_to); !exported) return print_error(exported.error());
  }
  if (options.json)
    std::cout << nlohmann::json::parse(shown.bytes.canonical).dump(2, ' ', /*ensure_ascii=*/true) << '\n';
  else
    std::cout << record_text(shown.record, chain->key_id(shown.record.sequence));
  return Exit::done;
}

Exit export_all(const Paths& paths, const std::filesystem::path& folder, bool as_json) {
  const auto chain = read_some(paths);
  if (!chain) return print_error(chain.error());
  for (const VerifiedRecord& item : chain->verified)
    if (const auto exported = export_record(item, folder); !exported) return print_error(exported.error());
  if (as_json)
    std::cout << json_text({{"schema", 1},
                            {"key", chain->key.id_text()},
                            {"stored", chain->stored},
                            {"exported", chain->verified.size()},
                            {"folder", folder.string()}},
                           2);
  else
    std::cout << counted(chain->verified.size(), "record") << " verified and exported, " << chain->keys() << '\n';
  return chain->broken ? print_error(*chain->broken) : Exit::done;
}

Exit verify(const Paths& paths, const std::vector<std::filesystem::path>& files, bool as_json) {
  if (!files.empty()) {
    const auto key = load_public_key(paths.public_key);
    return key ? verify_files(files, *key, as_json) : print_error(key.error());
  }
  const auto chain = read_some(paths);
  if (!chain) return print_error(chain.error());
  if (chain->broken) return print_error(*chain->broken);
  if (as_json) {
    std::cout << json_text({{"schema", 1}, {"key", chain->key.id_text()}, {"verified", chain->stored}}, 2);
    return Exit::done;
  }
  std::cout << counted(chain->stored, "record") << " verified, " << chain->keys() << "; chain unbroken\n";
  return Exit::done;
}

}  // namespace calib::ctl
