#include "extrinsic_formats/frame_files.hpp"

#include <algorithm>
#include <map>

#include "calib/file.hpp"

namespace calib::formats {
namespace {

Result<void> add_files(Format format, const std::vector<std::filesystem::path>& files, LoadedFrames& loaded) {
  std::vector<TextFile> texts;
  for (const auto& file : files) {
    auto text = read_regular_file(file, facts_of(format).max_bytes);
    if (!text) return propagate(text);
    texts.push_back({file.string(), *std::move(text)});
  }
  auto frames = read_frames(format, texts);
  if (!frames) return propagate(frames);
  for (FrameEdge& edge : frames->edges)
    if (const auto added = loaded.graph.add(std::move(edge)); !added) return added;
  if (frames->camera) loaded.camera = frames->camera;
  if (frames->lidar) loaded.lidar = frames->lidar;
  loaded.remark += frames->remark;
  return {};
}

}  // namespace

std::optional<Format> parse_format(std::string_view name) {
  const auto found = std::ranges::find(all_formats, name, &FormatFacts::name);
  return found == all_formats.end() ? std::nullopt : std::optional(found->format);
}

Result<LoadedFrames> load_frames(Format format, const std::vector<std::filesystem::path>& files,
                                 const std::vector<std::string>& with) {
  // All files of a format are read together: one may name what another one has.
  std::map<Format, std::vector<std::filesystem::path>> sorted;
  sorted[format] = files;
  for (const std::string& file : with) {
    const auto colon = file.find(':');
    const auto named = colon == std::string::npos ? std::nullopt : parse_format(file.substr(0, colon));
    sorted[named.value_or(format)].emplace_back(named ? file.substr(colon + 1) : file);
  }
  LoadedFrames loaded;
  for (const auto& [each, its_files] : sorted) {
    if (each == format) continue;
    if (const auto added = add_files(each, its_files, loaded); !added) return propagate(added);
  }
  if (!sorted[format].empty())
    if (const auto added = add_files(format, sorted[format], loaded); !added) return propagate(added);
  return loaded;
}

}  // namespace calib::formats
