#include "dataset/frames_by_name.hpp"

#include <algorithm>
#include <initializer_list>
#include <map>
#include <set>
#include <string>

#include "dataset/extension.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

/// Files of one folder by their names without extension.
using Files = std::map<std::string, fs::path>;

Result<Files> files_in(const fs::path& folder, const char* what, std::initializer_list<const char*> extensions) {
  std::error_code error;
  Files files;
  // Not a range, whose steps throw.
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error))
    if (std::ranges::find(extensions, extension_of(entry->path())) != extensions.end())
      files.emplace(entry->path().stem().string(), entry->path());
  if (error || files.empty()) return fail(ErrorCode::recording_not_found, folder.string() + " holds no " + what);
  return files;
}

Result<Files> images_in(const fs::path& folder) {
  return files_in(folder, "images (.png, .jpg, .tif, .bmp, .pgm)",
                  {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm"});
}

std::string description(const Files& files, const fs::path& folder) {
  return std::to_string(files.size()) + " in " + folder.string() + " (first: " + files.begin()->first + ")";
}

}  // namespace

Result<RecordedFrames> frames_by_name(const fs::path& images_folder, const std::optional<fs::path>& right_folder,
                                      const fs::path& clouds_folder) {
  const auto images = images_in(images_folder);
  if (!images) return propagate(images);
  const auto right_images = right_folder ? images_in(*right_folder) : Files{};
  if (!right_images) return propagate(right_images);
  const auto clouds = files_in(clouds_folder, "clouds (.bin, .pcd)", {".bin", ".pcd"});
  if (!clouds) return propagate(clouds);

  std::set<std::string> names;
  for (const Files& files : {*images, *clouds, *right_images})
    for (const auto& [name, path] : files) names.insert(name);
  RecordedFrames frames;
  for (const std::string& name : names) {
    const auto image = images->find(name), cloud = clouds->find(name), right = right_images->find(name);
    if (image == images->end())
      frames.lacks.push_back("no image for " + name);
    else if (cloud == clouds->end())
      frames.lacks.push_back("no cloud for " + name);
    else if (right_folder && right == right_images->end())
      frames.lacks.push_back("no right image for " + name);
    else
      frames.complete.push_back(
          {name, image->second, right_folder ? std::optional(right->second) : std::nullopt, cloud->second});
  }
  const std::size_t fewest =
      std::min({images->size(), clouds->size(), right_folder ? right_images->size() : images->size()});
  if (2 * frames.complete.size() < fewest)
    return fail(ErrorCode::frame_mismatch, "only " + std::to_string(frames.complete.size()) +
                                               " frames have the same name in all of " +
                                               description(*images, images_folder) +
                                               (right_folder ? ", " + description(*right_images, *right_folder) : "") +
                                               " and " + description(*clouds, clouds_folder));
  return frames;
}

}  // namespace calib
