#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "dataset/depth_files.hpp"
#include "scenario/adverse_places.hpp"
#include "vehicle/knock.hpp"

namespace calib::test {

/// One pair as it reaches the estimator, with the depth that its depth source has for it.
struct Sample {
  FramePair pair;
  DepthMap depth;
};

inline DepthMap true_depth(const vehicle::Rendering& seen) {
  DepthMap depth{seen.width, seen.height, {}};
  for (const float depth_m : seen.depth_m) depth.inverse_depth.push_back(std::isfinite(depth_m) ? 1 / depth_m : 0);
  return depth;
}

/// The scan of a LiDAR that has moved: the same points seen from elsewhere.
inline LidarScan moved_scan(const Shot& shot, const RigidTransform& motion) {
  LidarScan scan = shot.scan;
  vehicle::move_lidar(scan, motion);
  return scan;
}

inline Sample sound_sample(const AdversePlace& place, int index, const RigidTransform& motion) {
  const Shot& shot = place.shot(index);
  return {{vehicle::expose(shot.rendering, 0.9F, index), std::nullopt, moved_scan(shot, motion)},
          true_depth(shot.rendering)};
}

/// What may happen to sensors and depth. `spoil` gets the sample of shot `index`, of a LiDAR that has moved by
/// `motion`; `constant` is the same for all samples of a case, `changing` differs from sample to sample.
struct Adversity {
  struct Scene {
    const AdversePlace& place;
    RigidTransform motion;
    int index;
  };
  const char* name;
  void (*spoil)(Sample& sample, const Scene& scene, vehicle::Random& constant, vehicle::Random& changing);
};

namespace adverse {

using vehicle::Random;
using Scene = Adversity::Scene;

/// `change` maps place in the image (-1 .. 1 across and down) and inverse depth to inverse depth.
template <typename Change>
void each_depth(DepthMap& depth, Change change) {
  for (int y = 0; y < depth.height; ++y)
    for (int x = 0; x < depth.width; ++x)
      if (float& value = depth.inverse_depth[static_cast<std::size_t>(y * depth.width + x)]; value > 0)
        value = std::max(1e-4F, static_cast<float>(
                                    change((2 * x + 1.0) / depth.width - 1, (2 * y + 1.0) / depth.height - 1, value)));
}

/// As a camera has it that looks elsewhere by so many pixels.
inline void shift_depth(DepthMap& depth, int right, int down) {
  const DepthMap old = depth;
  for (int y = 0; y < depth.height; ++y)
    for (int x = 0; x < depth.width; ++x)
      depth.inverse_depth[static_cast<std::size_t>(y * depth.width + x)] = old.inverse_depth[static_cast<std::size_t>(
          std::clamp(y - down, 0, depth.height - 1) * depth.width + std::clamp(x - right, 0, depth.width - 1))];
}

inline void mirror_depth(DepthMap& depth) {
  for (int y = 0; y < depth.height; ++y) {
    const auto row = depth.inverse_depth.begin() + y * depth.width;
    std::reverse(row, row + depth.width);
  }
}

inline void shuffle_depth(DepthMap& depth, Random& random) {
  for (std::size_t i = depth.inverse_depth.size() - 1; i > 0; --i)
    std::swap(depth.inverse_depth[i], depth.inverse_depth[static_cast<std::size_t>(random.below(static_cast<int>(i)))]);
}

inline void bias_depth(DepthMap& depth, Random& amplitude, Random& shape) {
  add_smooth_bias(depth, amplitude.uniform(0.1F, 0.4F), shape.bits());
}

inline void darken(Image& image, const Scene& scene, Random& noise) {
  image = vehicle::expose(scene.place.shot(scene.index).rendering, 4e-5F, noise.bits());
}

/// Half of the returns are lost, and drops nearby give others.
inline void rain(LidarScan& scan, Random& random) {
  std::erase_if(scan.points, [&](const LidarPoint&) { return random.chance(0.5F); });
  for (LidarPoint& p : scan.points) {
    if (!random.chance(0.15F)) continue;
    const float share = random.uniform(0.5F, 6) / std::hypot(p.x_m, p.y_m, p.z_m);
    p = {p.x_m * share, p.y_m * share, p.z_m * share, 0.05F};
  }
}

inline void keep_beams(LidarScan& scan, int every) {
  std::erase_if(scan.points, [&](const LidarPoint& p) {
    return std::lround(std::atan2(p.z_m, std::hypot(p.x_m, p.y_m)) / (0.4 * radians_per_degree)) % every != 0;
  });
}

/// As if it had been taken when the vehicle had turned and driven on by so much.
inline void late(LidarScan& scan, double turned_deg, double driven_m) {
  vehicle::move_lidar(scan, knock(0, 0, turned_deg, driven_m));
}

inline void set_reflectance(LidarScan& scan, Random* random) {
  for (LidarPoint& p : scan.points) p.reflectance = random != nullptr ? random->uniform(0, 1) : 0;
}

inline Sample sample_of_another(const Scene& scene, int index) {
  return sound_sample(scene.place, index, scene.motion);
}

}  // namespace adverse

/// Not among them, as nothing in the frames could tell: depth that is displaced as a whole, from the first day on or
/// where reflectance says nothing, and a scan that is late by the same time in every frame of a steady drive.
inline const std::vector<Adversity>& adversities() {
  using namespace adverse;
  static const std::vector<Adversity> all{
      {"none", [](Sample&, const Scene&, Random&, Random&) {}},
      {"smooth depth bias", [](Sample& s, const Scene&, Random& c, Random&) { bias_depth(s.depth, c, c); }},
      {"another bias each frame", [](Sample& s, const Scene&, Random& c, Random& r) { bias_depth(s.depth, c, r); }},
      {"depth ramp",
       [](Sample& s, const Scene&, Random& c, Random&) {
         const float across = c.uniform(-0.4F, 0.4F), down = c.uniform(-0.4F, 0.4F);
         each_depth(s.depth, [&](double x, double y, float v) { return v * (1 + across * x) * (1 + down * y); });
       }},
      {"disparity off",
       [](Sample& s, const Scene&, Random& c, Random&) {
         const float more = c.uniform(-0.02F, 0.06F);
         each_depth(s.depth, [&](double, double, float v) { return v + more; });
       }},
      {"depth compressed",
       [](Sample& s, const Scene&, Random& c, Random&) {
         const float power = c.uniform(0.3F, 3);
         each_depth(s.depth, [&](double, double, float v) { return std::pow(v, power); });
       }},
      {"depth displaced",
       [](Sample& s, const Scene&, Random& c, Random&) {
         const int right = c.below(17) - 8;
         shift_depth(s.depth, right, c.below(9) - 4);
       }},
      {"depth mirrored", [](Sample& s, const Scene&, Random&, Random&) { mirror_depth(s.depth); }},
      {"depth constant", [](Sample& s, const Scene&, Random&,
                            Random&) { each_depth(s.depth, [](double, double, float) { return 0.1; }); }},
      {"depth shuffled", [](Sample& s, const Scene&, Random&, Random& r) { shuffle_depth(s.depth, r); }},
      {"depth of another frame",
       [](Sample& s, const Scene& at, Random&, Random&) { s.depth = sample_of_another(at, at.index + 3).depth; }},
      {"depth frozen",
       [](Sample& s, const Scene& at, Random& c, Random&) { s.depth = sample_of_another(at, c.below(40)).depth; }},
      {"depth rough",
       [](Sample& s, const Scene&, Random& c, Random& r) {
         const float sigma = c.uniform(0.1F, 0.5F);
         each_depth(s.depth, [&](double, double, float v) { return v * (1 + sigma * r.gaussian()); });
       }},
      {"night", [](Sample& s, const Scene& at, Random&, Random& r) { darken(s.pair.image, at, r); }},
      {"night, bias",
       [](Sample& s, const Scene& at, Random& c, Random& r) {
         darken(s.pair.image, at, r);
         bias_depth(s.depth, c, c);
       }},
      {"rain", [](Sample& s, const Scene&, Random&, Random& r) { rain(s.pair.scan, r); }},
      {"few beams", [](Sample& s, const Scene&, Random& c, Random&) { keep_beams(s.pair.scan, 4 + c.below(5)); }},
      {"LiDAR half covered",
       [](Sample& s, const Scene&, Random& c, Random&) {
         const bool left = c.chance(0.5F);
         std::erase_if(s.pair.scan.points, [&](const LidarPoint& p) { return (p.y_m > 0) == left; });
       }},
      {"unsynchronised", [](Sample& s, const Scene&, Random&,
                            Random& r) { late(s.pair.scan, r.uniform(-1, 1), r.uniform(-0.5F, 0.5F)); }},
      {"50 ms late in bends",
       [](Sample& s, const Scene&, Random&, Random& r) { late(s.pair.scan, r.gaussian(), 0.05F * r.uniform(0, 4)); }},
      {"standing", [](Sample& s, const Scene& at, Random& c, Random&) { s = sample_of_another(at, c.below(40)); }},
      {"camera frozen",
       [](Sample& s, const Scene& at, Random& c, Random&) {
         const Sample frozen = sample_of_another(at, c.below(40));
         s.pair.image = frozen.pair.image;
         s.depth = frozen.depth;
       }},
      {"cloud of another frame", [](Sample& s, const Scene& at, Random&,
                                    Random&) { s.pair.scan = sample_of_another(at, at.index + 3).pair.scan; }},
      {"cloud frozen", [](Sample& s, const Scene& at, Random& c,
                          Random&) { s.pair.scan = sample_of_another(at, c.below(40)).pair.scan; }},
      {"no reflectance", [](Sample& s, const Scene&, Random&, Random&) { set_reflectance(s.pair.scan, nullptr); }},
      {"random reflectance", [](Sample& s, const Scene&, Random&, Random& r) { set_reflectance(s.pair.scan, &r); }},
      {"no reflectance, bias",
       [](Sample& s, const Scene&, Random& c, Random&) {
         set_reflectance(s.pair.scan, nullptr);
         bias_depth(s.depth, c, c);
       }},
      {"rain, bias",
       [](Sample& s, const Scene&, Random& c, Random& r) {
         rain(s.pair.scan, r);
         bias_depth(s.depth, c, c);
       }},
  };
  return all;
}

}  // namespace calib::test
