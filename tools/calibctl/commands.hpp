#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/result.hpp"
#include "calib/wall_time.hpp"
#include "extrinsic_formats/formats.hpp"

namespace calib::ctl {

/// Exit status of a command; part of the interface, see calibctl(1).
enum class Exit {
  done = 0,
  failed = 1,
  usage = 2,
  not_found = 3,  // the daemon does not run, or what was asked for does not exist
  no = 4,         // the answer is no: not verified, rejected, not calibrated, ...
  timed_out = 5,  // `wait`: not reached in time
};

/// Of calibd's files.
struct Paths {
  std::filesystem::path socket, state_dir, public_key;
  [[nodiscard]] std::filesystem::path store() const { return state_dir / "calibd.db"; }
  /// In calibd's default of `head_dir`.
  [[nodiscard]] std::filesystem::path chain_head() const {
    const auto folder = state_dir.has_filename() ? state_dir : state_dir.parent_path();
    return std::filesystem::path(folder.string() + "-head") / "chain-head.json";
  }
  [[nodiscard]] std::filesystem::path snapshot() const { return socket.parent_path() / "status.json"; }
};

/// The exit status for an error.
[[nodiscard]] Exit exit_for(const Error& error);
/// Prints `error` to standard error and returns its exit status.
Exit print_error(const Error& error);

struct StatusOptions {
  std::string pair;  // a row for each of all pairs when empty
  bool json = false, watch = false, exit_code = false;
};
Exit status(const Paths& paths, const StatusOptions& options);

enum class WaitFor { calibrated, drifted, not_evaluated, any_change };
[[nodiscard]] std::string_view to_string(WaitFor what);
struct WaitOptions {
  std::string pair;  // all when empty
  WaitFor what = WaitFor::calibrated;
  std::chrono::milliseconds timeout = std::chrono::minutes(1);
  bool json = false;
};
/// `60s`, `500ms`, `2min`, `1h`, or a number of seconds; a year at most. Nothing for any other text.
[[nodiscard]] std::optional<std::chrono::milliseconds> parse_duration(std::string_view text);
/// Waits until the running calibd says that the state is reached.
Exit wait(const Paths& paths, const WaitOptions& options);

/// Lists the records of one pair, or of all when `pair` is empty.
Exit history(const Paths& paths, const std::string& pair, bool as_json);

struct ShowOptions {
  std::optional<std::uint64_t> sequence;  // of the last record by default
  bool json = false;
  std::filesystem::path export_to;  // nothing is exported when empty
};
Exit show(const Paths& paths, const ShowOptions& options);

/// Writes every record up to the first that does not verify, as `ShowOptions::export_to` does one.
Exit export_all(const Paths& paths, const std::filesystem::path& folder, bool as_json);

/// Verifies `files` (exported records, in any order), or the whole chain of the store when there are none.
Exit verify(const Paths& paths, const std::vector<std::filesystem::path>& files, bool as_json);

// `comment` is for the record, and may be empty.
Exit recalibrate(const Paths& paths, const std::string& pair, bool dry_run, const std::string& comment, bool as_json);
Exit accept(const Paths& paths, const std::string& pair, const std::string& comment, bool as_json);
Exit roll_back(const Paths& paths, const std::string& pair, std::optional<std::uint64_t> to, const std::string& comment,
               bool as_json);

struct KeyOptions {
  std::filesystem::path file;  // secret key
  bool lost = false;
  std::optional<std::uint64_t> doubted_from;
  std::string comment;
  bool json = false;
};
/// Lets calibd sign with the key in `file` from now on; or, where the key before it is lost, with the one it has.
Exit rotate_key(const Paths& paths, const KeyOptions& options);

/// `2026-01-31T12:00:00Z`, `2026-01-31` (UTC), or so long before now: `90min`, `2h`, `7d`.
[[nodiscard]] std::optional<WallTime> parse_since(std::string_view text);
struct EventsOptions {
  std::string pair;               // of all, and of none, when empty
  std::optional<WallTime> since;  // all when not given
  std::filesystem::path journal;  // folder of journal files in place of the system's journal
  bool json = false;
};
/// Lists what happened, from the records, the alerts in the store and the journal, oldest first. Says which of them
/// could not be read.
Exit events(const Paths& paths, const EventsOptions& options);

/// Lets calibd read its configuration again.
Exit reload(const Paths& paths, bool as_json);

struct AlertsOptions {
  bool json = false, follow = false, acknowledge = false;
};
/// Prints the events that wait for the fleet, and with `follow` those that come.
Exit alerts(const Paths& paths, const AlertsOptions& options);

struct DoctorOptions {
  std::string pair;  // all when empty
  bool json = false;
  std::filesystem::path overlay_dir;  // pictures stay where calibd writes them when empty
};
/// Lets calibd run its diagnostics.
Exit doctor(const Paths& paths, const DoctorOptions& options);

struct ExplainOptions {
  std::string code;   // all are listed when empty
  bool page = false;  // the manual page of all codes, for scdoc
  bool json = false;
};
/// Says what a code means, with an example and a remedy. Needs no daemon.
Exit explain(const ExplainOptions& options);

struct ImportOptions {
  formats::Format format = formats::Format::tf;
  std::vector<std::filesystem::path> files;
  std::vector<std::string> with;  // more files, FILE or FORMAT:FILE
  std::string camera, lidar;      // frames; empty where the files leave no choice
  std::optional<formats::CameraAxes> axes;
  bool inverse = false, check = true, json = false;
};
/// Prints T_camera_lidar of others' files, for a configuration. Exits with `no` where it is not plausible.
Exit import_extrinsic(const ImportOptions& options);

struct ExportOptions {
  formats::Format format = formats::Format::tf;
  std::string pair;                     // empty where there is one only
  std::optional<std::uint64_t> record;  // that of the extrinsic in force by default
  std::filesystem::path config;         // in place of records
  std::vector<std::string> with;
  std::string camera, lidar, parent;
  std::optional<formats::CameraAxes> axes;
  formats::TfForm tf_form = formats::TfForm::arguments;
};
/// Prints an extrinsic in the format of others.
Exit export_extrinsic(const Paths& paths, const ExportOptions& options);
/// The axes of a camera frame where nothing is said: those of the format, unless the frame's name holds `optical`.
[[nodiscard]] formats::CameraAxes axes_of(const formats::FormatFacts& facts, std::string_view camera_frame);

Exit check_config(const std::filesystem::path& file, bool as_json);
/// Runs calib-check-model with these arguments, in place of this process; returns only when it cannot.
Exit check_model(const std::vector<std::string>& arguments);
Exit keygen(const std::filesystem::path& file, bool as_json);

}  // namespace calib::ctl
