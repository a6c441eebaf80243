#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <map>

#include "commands.hpp"

namespace calib::ctl {

Exit exit_for(const Error& error) {
  switch (error.code) {
    case ErrorCode::daemon_not_running:
    case ErrorCode::not_found:
    case ErrorCode::store_not_found:
    case ErrorCode::key_not_found:
    case ErrorCode::record_not_found:
      return Exit::not_found;
    case ErrorCode::bad_signature:
    case ErrorCode::wrong_key:
    case ErrorCode::broken_chain:
    case ErrorCode::malformed_record:
      return Exit::no;
    case ErrorCode::bad_request:
    case ErrorCode::bad_name:
      return Exit::usage;
    default:
      return Exit::failed;
  }
}

Exit print_error(const Error& error) {
  std::cout << std::flush;
  std::cerr << "calibctl: " << escape_control(error.context) << '\n';
  return exit_for(error);
}

namespace {

Paths default_paths() {
  const char* const runtime = std::getenv("RUNTIME_DIRECTORY");
  const std::string folder = runtime != nullptr && *runtime != '\0' ? runtime : "/run/calibd";
  // systemd separates several folders with colons; the first is calibd's.
  return {std::filesystem::path(folder.substr(0, folder.find(':'))) / "control.sock", "/var/lib/calibd",
          "/etc/calibd/signing.pub"};
}

/// All commands and options.
struct CommandLine {
  CLI::App app{"Show, verify and change what calibd does about the extrinsics of a vehicle", "calibctl"};
  Paths paths = default_paths();
  StatusOptions status;
  WaitOptions wait;
  ShowOptions show;
  AlertsOptions alerts;
  DoctorOptions doctor;
  EventsOptions events;
  ExplainOptions explain;
  ImportOptions import_options;
  ExportOptions export_options;
  KeyOptions new_key;
  std::string pair, comment;
  bool dry_run = false, all_records = false, json = false;
  std::optional<std::uint64_t> roll_back_to;
  std::vector<std::filesystem::path> files;
  std::filesystem::path config_file, key_file, export_to;
  std::function<Exit()> command;

  CommandLine();

 private:
  CLI::App* subcommand(const std::string& name, const std::string& what, std::function<Exit()> run) {
    CLI::App* const added = app.add_subcommand(name, what)->fallthrough();
    added->callback([this, run = std::move(run)] { command = run; });
    return added;
  }
  void add_json(CLI::App* to) { to->add_flag("--json", json, "Print JSON as defined by calibctl.schema.json"); }
  void add_wait();
  void add_events();
  void add_records();
  void add_requests();
  void add_alerts();
  void add_doctor();
  void add_formats();
};

CommandLine::CommandLine() {
  app.require_subcommand(1);
  app.set_version_flag("--version", "calibctl " CALIBD_VERSION);
  app.add_option("--socket", paths.socket, "Control socket of calibd; status.json lies beside it")
      ->capture_default_str();
  app.add_option("--state-dir", paths.state_dir, "Folder of calibd.db")->capture_default_str();
  app.add_option("--public-key", paths.public_key, "Key that records are verified with")->capture_default_str();

  auto* const ask_status =
      subcommand("status", "Show the verdict of every pair", [this] { return ctl::status(paths, status); });
  ask_status->add_option("PAIR", status.pair, "Show everything about this pair; one row a pair if not given");
  ask_status->add_flag("--json", status.json, "Print JSON as defined by status.schema.json");
  ask_status->add_flag("--watch", status.watch, "Repeat every second, until interrupted");
  ask_status->add_flag("--exit-code", status.exit_code, "Exit with 4 unless every pair is calibrated");
  add_wait();
  add_events();
  add_records();
  add_requests();
  add_alerts();
  add_doctor();
  add_formats();

  auto* const meaning =
      subcommand("explain", "Say what a code means, and what to do", [this] { return ctl::explain(explain); });
  meaning->add_option("CODE", explain.code, "All are listed if not given");
  meaning->add_flag("--json", explain.json, "Print JSON as defined by calibctl.schema.json");
  meaning->add_flag("--page", explain.page, "Print calibd-codes(7), for scdoc");
  auto* const check = subcommand("check-config", "Check a configuration and print the first error",
                                 [this] { return check_config(config_file, json); });
  check->add_option("FILE", config_file)->required();
  add_json(check);
  // Its arguments, --help among them, are calib-check-model's.
  auto* const network =
      app.add_subcommand("check-model", "Check a depth network against its descriptor and on a frame");
  network->prefix_command()->set_help_flag();
  network->callback([this, network] { command = [network] { return check_model(network->remaining()); }; });
  auto* const make_key =
      subcommand("keygen", "Make a signing key and its public key", [this] { return keygen(key_file, json); });
  add_json(make_key);
  make_key->add_option("--out", key_file, "Secret key; the public key gets the extension .pub")->required();
}

void CommandLine::add_wait() {
  auto* const until = subcommand("wait", "Wait until the running calibd says that a state is reached",
                                 [this] { return ctl::wait(paths, wait); });
  until->add_option("PAIR", wait.pair, "Of all pairs if not given");
  until
      ->add_option_function<std::string>(
          "--for",
          [this](const std::string& text) {
            for (const WaitFor state :
                 {WaitFor::calibrated, WaitFor::drifted, WaitFor::not_evaluated, WaitFor::any_change})
              if (to_string(state) == text) wait.what = state;
          },
          "calibrated, drifted, not_evaluated or any-change")
      ->required()
      ->check(CLI::IsMember({"calibrated", "drifted", "not_evaluated", "any-change"}));
  until
      ->add_option_function<std::string>(
          "--timeout",
          [this](const std::string& text) {
            const auto timeout = parse_duration(text);
            if (!timeout) throw CLI::ValidationError("--timeout", text + " is not a time such as 60s, 2min or 1h");
            wait.timeout = *timeout;
          },
          "Exit with 5 after this time: 60s, 500ms, 2min, 1h")
      ->default_str("60s");
  until->add_flag("--json", wait.json, "Print JSON as defined by wait.schema.json");
}

void CommandLine::add_events() {
  auto* const list = subcommand("events", "List what happened, from the records, the alerts and the journal",
                                [this] { return ctl::events(paths, events); });
  list->add_option("PAIR", events.pair, "Of all pairs, and of calibd itself, if not given");
  list->add_option_function<std::string>(
      "--since",
      [this](const std::string& text) {
        const auto time = parse_since(text);
        if (!time)
          throw CLI::ValidationError("--since", text +
                                                    " is neither a time such as 2026-01-31T12:00:00Z or 2026-01-31 "
                                                    "(UTC) nor one ago such as 90min, 2h or 7d");
        events.since = *time;
      },
      "Not before this time (2026-01-31T12:00:00Z, 2026-01-31) or so long ago (90min, 2h, 7d)");
  list->add_option("--journal", events.journal, "Folder of journal files, in place of the system's journal");
  list->add_flag("--json", events.json, "Print JSON as defined by calibctl.schema.json");
}

void CommandLine::add_alerts() {
  auto* const list =
      subcommand("alerts", "List the events that wait for the fleet", [this] { return ctl::alerts(paths, alerts); });
  list->add_flag("--json", alerts.json, "Print a line of JSON as defined by feed.schema.json for each");
  list->add_flag("--follow", alerts.follow, "Go on with those that come, until interrupted");
  list->add_flag("--ack", alerts.acknowledge, "Remove them from the outbox once they are printed");
}

void CommandLine::add_doctor() {
  auto* const examine = subcommand("doctor", "Diagnose sensors, clocks, calibration and depth",
                                   [this] { return ctl::doctor(paths, doctor); });
  examine->add_option("PAIR", doctor.pair, "All pairs if not given");
  examine->add_flag("--json", doctor.json, "Print JSON as defined by doctor.schema.json");
  examine->add_option("--overlay", doctor.overlay_dir, "Copy the pictures into this folder");
}

void CommandLine::add_formats() {
  std::map<std::string, formats::Format> format_names;
  for (const auto& facts : formats::all_formats) format_names.emplace(facts.name, facts.format);
  const std::map<std::string, formats::CameraAxes> axes{{"optical", formats::CameraAxes::optical},
                                                        {"body", formats::CameraAxes::body}};
  const std::map<std::string, formats::TfForm> forms{
      {"arguments", formats::TfForm::arguments}, {"yaml", formats::TfForm::yaml}, {"json", formats::TfForm::json}};
  const auto add_common = [&](CLI::App* to, auto& options) {
    auto* const format =
        to->add_option("--format", options.format, "tf, kitti, autoware, kalibr, urdf, opencalib, nuscenes or kitti360")
            ->transform(CLI::Transformer(format_names).description(""));
    to->add_option("--camera", options.camera, "Frame of the camera in the file");
    to->add_option("--lidar", options.lidar, "Frame of the LiDAR in the file");
    to->add_option("--camera-axes", options.axes, "Axes of the camera's frame: optical or body")
        ->transform(CLI::Transformer(axes).description(""));
    to->add_option("--with", options.with, "A file with more transforms: FILE or FORMAT:FILE; can be repeated")
        ->expected(1)
        ->take_all();
    return format;
  };
  auto* const in = subcommand("import", "Print T_camera_lidar from a calibration file of other programs",
                              [this] { return import_extrinsic(import_options); });
  add_common(in, import_options)->required();
  in->add_option("FILE", import_options.files)->required();
  in->add_flag("--inverse", import_options.inverse, "The file has the transform in the other direction");
  in->add_flag("!--no-check", import_options.check, "Print it even where it is not plausible");
  in->add_flag("--json", import_options.json, "Print JSON");
  auto* const out = subcommand(
      "export", "Print the extrinsic in force in the format of other programs, or write all records into a folder",
      [this] { return all_records ? export_all(paths, export_to, json) : export_extrinsic(paths, export_options); });
  auto* const format = add_common(out, export_options);
  auto* const all = out->add_flag("--all", all_records, "All records of the store, verified")->excludes(format);
  auto* const to =
      out->add_option("--to", export_to, "Write NNNNNN.json and NNNNNN.json.minisig into this folder")->needs(all);
  all->needs(to);
  out->add_flag("--json", json, "With --all: print JSON as defined by calibctl.schema.json")->needs(all);
  out->parse_complete_callback([format, all] {
    if (format->count() + all->count() == 0) throw CLI::RequiredError("--format or --all");
  });
  out->add_option("PAIR", export_options.pair, "May be left out where there is only one");
  auto* const record =
      out->add_option("--record", export_options.record, "That of this record instead")->check(CLI::PositiveNumber);
  out->add_option("--config", export_options.config, "That of this configuration instead")->excludes(record);
  out->add_option("--parent", export_options.parent,
                  "Frame in which the camera's pose is written; default: the LiDAR's");
  out->add_option("--tf-form", export_options.tf_form, "Of format tf: arguments, yaml or json")
      ->transform(CLI::Transformer(forms).description(""));
}

void CommandLine::add_records() {
  auto* const list =
      subcommand("history", "List the records, each verified", [this] { return history(paths, pair, json); });
  list->add_option("PAIR", pair);
  add_json(list);
  auto* const one = subcommand("show", "Show a verified record, the last one if no number is given",
                               [this] { return ctl::show(paths, show); });
  one->add_option("SEQ", show.sequence)->check(CLI::PositiveNumber);
  one->add_flag("--json", show.json, "Print JSON as defined by record.schema.json");
  one->add_option("--export", show.export_to, "Write NNNNNN.json and NNNNNN.json.minisig into this folder");
  auto* const check = subcommand("verify", "Verify the whole chain of the store, or exported records",
                                 [this] { return verify(paths, files, json); });
  check->add_option("FILES", files);
  add_json(check);
}

void CommandLine::add_requests() {
  auto* const again = subcommand("recalibrate", "Recalibrate a pair now, from its last good frames",
                                 [this] { return recalibrate(paths, pair, dry_run, comment, json); });
  add_json(again);
  again->add_option("PAIR", pair)->required();
  again->add_flag("--dry-run", dry_run, "Decide, but change nothing");
  auto* const yes = subcommand("accept", "Put the proposed extrinsic of a pair in force",
                               [this] { return accept(paths, pair, comment, json); });
  add_json(yes);
  yes->add_option("PAIR", pair)->required();
  auto* const back = subcommand("rollback", "Put an earlier extrinsic of a pair in force again",
                                [this] { return roll_back(paths, pair, roll_back_to, comment, json); });
  add_json(back);
  back->add_option("PAIR", pair)->required();
  auto* const anew = subcommand("reload", "Let calibd read its configuration again, as far as nothing is lost by that",
                                [this] { return reload(paths, json); });
  anew->add_flag("--json", json, "Print JSON as defined by reload.schema.json");
  back->add_option("--to", roll_back_to, "Record of that extrinsic; the one before the present one if not given")
      ->check(CLI::PositiveNumber);
  auto* const rotate = subcommand("rotate-key", "Let another key sign the records from now on",
                                  [this] { return rotate_key(paths, new_key); });
  auto* const file = rotate->add_option("FILE", new_key.file, "The next secret key, made with keygen");
  auto* const lost = rotate->add_flag("--lost", new_key.lost, "The key before is lost; calibd has the next one already")
                         ->excludes(file);
  rotate->add_option("--doubt-from", new_key.doubted_from, "Somebody else may have signed from this record on")
      ->check(CLI::PositiveNumber);
  rotate->parse_complete_callback([file, lost] {
    if (file->count() + lost->count() == 0) throw CLI::RequiredError("FILE or --lost");
  });
  rotate->add_flag("--json", new_key.json, "Print JSON as defined by calibctl.schema.json");
  rotate->add_option("--comment", new_key.comment, "Why, for the record");
  for (CLI::App* const each : {again, yes, back}) each->add_option("--comment", comment, "Why, for the record");
}

}  // namespace
}  // namespace calib::ctl

int main(int argc, char** argv) {
  calib::ctl::CommandLine line;
  try {
    line.app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return line.app.exit(error) == 0 ? 0 : static_cast<int>(calib::ctl::Exit::usage);
  }
  const auto exit = line.command();
  std::cout << std::flush;
  // A full disk or a closed pipe must not look like success.
  return static_cast<int>(std::cout ? exit : calib::ctl::Exit::failed);
}
