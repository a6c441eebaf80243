#include <algorithm>
#include <array>
#include <cctype>
#include <iostream>

#include "calib/file.hpp"
#include "commands.hpp"
#include "control_client.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;

/// calibd listens to each pair for some seconds and estimates depth several times.
constexpr std::chrono::minutes diagnosis_timeout{10};

struct Check {
  std::string pair, check, result, seen, cause, remedy, code;
};

struct Overlay {
  std::string pair, file;
};

struct Diagnosis {
  std::vector<Check> checks;
  std::vector<Overlay> overlays;
};

/// Most important first.
constexpr std::array<std::string_view, 4> results{"problem", "warning", "not_checked", "ok"};

Result<Diagnosis> parse_diagnosis(const json& reply) {
  Diagnosis diagnosis;
  try {
    for (const json& check : reply.at("checks")) {
      const auto words = [&](const char* key) { return check.value(key, std::string()); };
      diagnosis.checks.push_back({check.at("pair").get<std::string>(), check.at("check").get<std::string>(),
                                  check.at("result").get<std::string>(), check.at("seen").get<std::string>(),
                                  words("cause"), words("remedy"), words("code")});
    }
    for (const json& overlay : reply.at("overlays"))
      diagnosis.overlays.push_back({overlay.at("pair").get<std::string>(), overlay.at("file").get<std::string>()});
  } catch (const json::exception& error) {
    return fail(ErrorCode::malformed_reply,
                std::string("calibd answered in a form that is not understood: ") + error.what());
  }
  const bool known = std::ranges::all_of(
      diagnosis.checks, [](const Check& check) { return std::ranges::find(results, check.result) != results.end(); });
  if (diagnosis.checks.empty() || !known)
    return fail(ErrorCode::malformed_reply, "calibd answered with no check, or with a result that is not understood");
  return diagnosis;
}

std::size_t count(const Diagnosis& diagnosis, std::string_view result, std::string_view pair = "") {
  return static_cast<std::size_t>(std::ranges::count_if(diagnosis.checks, [&](const Check& check) {
    return check.result == result && (pair.empty() || check.pair == pair);
  }));
}

/// `cloud_range` is shown as `Cloud range`.
std::string label_of(std::string name) {
  std::ranges::replace(name, '_', ' ');
  if (!name.empty()) name[0] = static_cast<char>(std::toupper(static_cast<unsigned char>(name[0])));
  return name;
}

void check_lines(Text& text, const Check& check) {
  const std::string result = check.result == "problem"       ? "PROBLEM"
                             : check.result == "not_checked" ? "not checked"
                                                             : check.result;
  text.line(label_of(check.check), result + ": " + check.seen);
  if (!check.cause.empty()) text.line("  likely cause", check.cause);
  if (!check.remedy.empty()) text.line("  remedy", check.remedy);
  if (!check.code.empty()) text.line("  code", check.code);
}

void pair_lines(Text& text, const Diagnosis& diagnosis, const std::string& pair) {
  text.line("Pair", pair);
  text.line("Found", counted(count(diagnosis, "problem", pair), "problem") + ", " +
                         counted(count(diagnosis, "warning", pair), "warning"));
  for (const std::string_view result : results)
    for (const Check& check : diagnosis.checks)
      if (check.pair == pair && check.result == result) check_lines(text, check);
  for (const Overlay& overlay : diagnosis.overlays)
    if (overlay.pair == pair) text.line("Picture", overlay.file);
}

std::string diagnosis_text(const Diagnosis& diagnosis) {
  Text text(/*coloured=*/false);
  std::vector<std::string> pairs;
  for (const Check& check : diagnosis.checks)
    if (std::ranges::find(pairs, check.pair) == pairs.end()) pairs.push_back(check.pair);
  for (const std::string& pair : pairs) {
    if (pair != pairs.front()) text.blank();
    pair_lines(text, diagnosis, pair);
  }
  return text.str();
}

/// calibctl may run as root, so a reply must not make it copy any file but a picture.
Result<std::string> read_picture(const std::filesystem::path& file) {
  constexpr std::uint64_t most_bytes = 256 << 20;
  auto bytes = read_regular_file(file, most_bytes);
  if (bytes && !bytes->starts_with("\x89PNG\r\n")) return fail(ErrorCode::malformed_reply, "it is not a picture");
  return bytes;
}

/// Copies the pictures from calibd's folder, and replaces their names in the reply by those of the copies.
Result<void> copy_overlays(json& reply, const std::filesystem::path& folder) {
  std::error_code error;
  if (is_foreign_link(folder)) return fail(ErrorCode::failed, folder.string() + " is a link that another user created");
  std::filesystem::create_directories(folder, error);
  for (json& overlay : reply["overlays"]) {
    const std::filesystem::path from = overlay["file"].get<std::string>();
    const std::filesystem::path to = folder / from.filename();
    const auto copied = read_picture(from).and_then([&](const std::string& bytes) { return replace_file(to, bytes); });
    if (!copied)
      return fail(ErrorCode::failed,
                  from.string() + " cannot be copied to " + to.string() + ": " + copied.error().context);
    overlay["file"] = to.string();
  }
  return {};
}

Error with_remedy(Error error) {
  if (error.code == ErrorCode::daemon_not_running)
    error.context +=
        "; to find out why: calibctl check-config /etc/calibd/calibd.yaml, systemctl status calibd, "
        "journalctl -u calibd";
  return error;
}

}  // namespace

Exit doctor(const Paths& paths, const DoctorOptions& options) {
  const json pair = options.pair.empty() ? json() : json(options.pair);
  auto reply =
      ask(paths.socket, {{"schema", 1}, {"request", "doctor"}, {"pair", pair}}, diagnosis_timeout, show_waiting);
  clear_waiting();
  if (!reply) return print_error(with_remedy(reply.error()));
  auto diagnosis = parse_diagnosis(*reply);
  if (!diagnosis) return print_error(diagnosis.error());
  Result<void> taken;
  if (!options.overlay_dir.empty()) {
    taken = copy_overlays(*reply, options.overlay_dir);
    diagnosis = parse_diagnosis(*reply);
  }
  std::cout << (options.json ? json_text(*reply, 2) : diagnosis_text(*diagnosis));
  if (!taken) return print_error(taken.error());
  if (count(*diagnosis, "problem") > 0) return Exit::failed;
  // A pair whose calibration could not be checked is not reported as good.
  const bool checked = std::ranges::all_of(diagnosis->checks, [](const Check& check) {
    return check.result != "not_checked" || (check.check != "agreement" && check.check != "extrinsic");
  });
  return checked ? Exit::done : Exit::no;
}

}  // namespace calib::ctl
