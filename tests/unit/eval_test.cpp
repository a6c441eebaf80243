#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <numbers>
#include <numeric>
#include <set>
#include <sstream>

#include "calib_eval/experiment.hpp"
#include "calib_eval/figures.hpp"
#include "calib_eval/landscape.hpp"
#include "calib_eval/parallel.hpp"
#include "calib_eval/report.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::eval;

namespace {

Run ended_at(double roll_deg, double x_cm) {
  Run run;
  Vector6 delta = Vector6::Zero();
  delta[0] = roll_deg * radians_per_degree;
  delta[3] = x_cm / 100;
  run.end = perturbation(delta);
  run.result = SearchResult{};
  run.result->evaluations = 10;
  run.seconds = 2;
  return run;
}

}  // namespace

TEST_CASE("points of the Fibonacci sphere are on it and keep their distance") {
  constexpr int count = 200;
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3d point = fibonacci_point(i, count);
    CHECK(point.norm() == Approx(1));
    sum += point;
    // 200 caps that cover the sphere are 0.14 wide; the nearest neighbour is not much nearer.
    for (int j = 0; j < i; ++j) REQUIRE((point - fibonacci_point(j, count)).norm() > 0.14);
  }
  CHECK((sum / count).norm() < 0.005);
}

TEST_CASE("starts are as far off as asked for, in rotation and translation") {
  for (const RigidTransform& motion : starting_motions({10, 50}, true, 50, 1)) {
    const Vector6 delta = perturbation_parameters(motion);
    CHECK(delta.head<3>().norm() == Approx(10 * radians_per_degree));
    CHECK(delta.tail<3>().norm() == Approx(0.5));
  }
  for (const RigidTransform& motion : starting_motions({10, 50}, false, 50, 1)) CHECK(motion.translation().norm() == 0);
}

TEST_CASE("a start's translation has nothing to do with its rotation, and every point is used once") {
  for (const int count : {7, 12, 60, 100, 200, 233, 377}) {
    double along = 0, squared = 0;
    std::set<long> heights;
    for (const RigidTransform& motion : starting_motions({1, 100}, true, count, 1)) {
      const Vector6 delta = perturbation_parameters(motion);
      const double cosine = delta.head<3>().normalized().dot(delta.tail<3>());
      along += cosine;
      squared += cosine * cosine;
      heights.insert(std::lround(1e6 * delta[5]));
    }
    CHECK(heights.size() == static_cast<std::size_t>(count));
    if (count < 50) continue;
    CAPTURE(count);
    CHECK(std::abs(along / count) < 0.15);                 // 0 if independent
    CHECK(squared / count == Approx(1. / 3).margin(0.1));  // one third if independent
  }
}

TEST_CASE("orientations drawn from all there are lean nowhere, and depend on the seed alone") {
  constexpr int count = 4000;
  Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
  double angles = 0;
  for (const RigidTransform& motion : starting_motions({180, 0}, false, count, 1)) {
    CHECK((motion.linear() * motion.linear().transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-5);
    sum += motion.linear();
    angles += rotation_angle_rad(motion);
  }
  CHECK((sum / count).norm() < 0.06);
  CHECK(angles / count == Approx(std::numbers::pi / 2 + 2 / std::numbers::pi).margin(0.03));  // Haar measure

  const auto same = starting_motions({180, 0}, false, 3, 7), again = starting_motions({180, 0}, false, 3, 7);
  CHECK(same[2].isApprox(again[2]));
  CHECK_FALSE(same[2].isApprox(starting_motions({180, 0}, false, 3, 8)[2]));
}

TEST_CASE("limits leave room beyond every start, and features reach as far as a search may get") {
  const ErrorRange range{20, 50};
  CHECK(search_bounds(range).rotation_rad == Approx(26 * radians_per_degree));
  CHECK(search_bounds(range).translation_m == Approx(0.725));
  CHECK(reach(range).rotation_rad == Approx(46 * radians_per_degree));
  CHECK(reach(range).translation_m == Approx(1.225));
}

TEST_CASE("frames are spread from the first to the last") {
  CHECK(spread_evenly(100, 3) == std::vector<std::size_t>{0, 50, 99});
  CHECK(spread_evenly(4, 25) == std::vector<std::size_t>{0, 1, 2, 3});
  CHECK(spread_evenly(0, 25).empty());
  CHECK(spread_evenly(9, 1) == std::vector<std::size_t>{4});
}

TEST_CASE("a hit is less than half a degree and 20 cm off") {
  CHECK(ended_at(0.49, 19).hit());
  CHECK_FALSE(ended_at(0.51, 0).hit());
  CHECK_FALSE(ended_at(0, 20.1).hit());
  Run failed = ended_at(0, 0);
  failed.result = fail(ErrorCode::search_failed, "");
  CHECK_FALSE(failed.hit());
}

TEST_CASE("a summary's errors and spread are of the hits, beside those of all runs") {
  std::vector<Run> runs{ended_at(0.1, 2), ended_at(-0.3, 4), ended_at(5, 0), ended_at(0, 0)};
  runs.back().result = fail(ErrorCode::search_failed, "");
  const Summary summary = summarise(runs);
  CHECK(summary.starts == 4);
  CHECK(summary.hits == 2);
  CHECK(summary.failures == 1);
  CHECK(*summary.hit_rotation_error_deg == Approx(0.2));
  CHECK(*summary.hit_translation_error_cm == Approx(3));
  CHECK((*summary.of_hits.mean)[0] == Approx(-0.1));
  CHECK((*summary.of_hits.standard_deviation)[0] == Approx(std::sqrt(0.08)));
  CHECK((*summary.of_hits.mean)[3] == Approx(3));
  CHECK((*summary.of_all.mean)[0] == Approx(1.6));
  CHECK(*summary.evaluations == Approx(10));
  CHECK(*summary.seconds_per_run == Approx(2));
}

TEST_CASE("what is over too few runs is null in the result") {
  Experiment experiment{{}, {ended_at(5, 0)}, std::nullopt};
  Json json = to_json(experiment);
  CHECK(json["hits"] == 0);
  CHECK(json["hit_rotation_error_deg"].is_null());
  CHECK(json["mean"].is_null());
  CHECK(json["all_mean"].size() == 6);
  CHECK(json["all_std"].is_null());
  experiment.runs.clear();
  json = to_json(experiment);
  CHECK(json["seconds_per_run"].is_null());
  CHECK(json["hit_rate"] == 0);
}

TEST_CASE("a joint histogram counts points where they land, and none that are out of view") {
  auto planes = std::make_shared<FeaturePlanes>();
  planes->grid = {.width = 2, .height = 1, .fx = 1, .fy = 1, .cx = 0, .cy = 0, .xi = 0};
  planes->packed.assign(planes->grid.pixels(), FeaturePlanes::grey.put(0xFFFF, 239));
  planes->packed[0] = FeaturePlanes::depth.put(planes->packed[0], 8);
  FeatureSet frame;
  frame.planes = planes;
  // On the first pixel twice, on the second one (no depth), behind the camera, beside the image.
  frame.set_points(std::vector<Eigen::Vector3f>{{0, 0, 1}, {0.4F, 0, 1}, {1, 0, 1}, {0, 0, -1}, {3, 0, 1}}, 3);
  frame.range_rank = {16, 239, 0, 0, 0};
  frame.reflectance_rank = {0, 0, 0, 0, 0};
  const auto at = [](const JointHistogram& histogram, int row, int column) {
    return histogram.counts[row * JointHistogram::classes + column];
  };
  const auto sum = [](const JointHistogram& histogram) {
    return std::accumulate(histogram.counts.begin(), histogram.counts.end(), 0);
  };
  const JointHistogram depth = joint_histogram(frame, RigidTransform::Identity(), Features::depth);
  CHECK(at(depth, 2, 1) == 1);
  CHECK(at(depth, 29, 1) == 1);
  CHECK(sum(depth) == 2);
  const JointHistogram intensity = joint_histogram(frame, RigidTransform::Identity(), Features::intensity);
  CHECK(at(intensity, 0, 29) == 3);
  CHECK(sum(intensity) == 3);
}

TEST_CASE("axis pairs are two different axes") {
  CHECK(test::require_ok(parse_axis_pair("pitch:z")) == std::array{1, 5});
  for (const char* wrong : {"", "roll", "roll:", ":roll", "roll:roll", "roll:up", "roll:pitch:yaw", "roll\n:x"})
    CHECK(parse_axis_pair(wrong).error().code == "unknown_axis");
}

TEST_CASE("work is done once each, by any number of threads") {
  for (const int threads : {1, 3, 50}) {
    std::vector<std::atomic<int>> done(20);
    parallel_for(done.size(), threads, [&](std::size_t i) { ++done[i]; });
    CHECK(std::ranges::all_of(done, [](int times) { return times == 1; }));
  }
  parallel_for(0, 3, [](std::size_t) { FAIL("there is no work"); });
  for (const int threads : {1, 4})
    CHECK_THROWS_AS(parallel_for(100, threads, [](std::size_t) { throw std::bad_alloc(); }), std::bad_alloc);
}

TEST_CASE("axes that were not searched have no standard error and are not observable") {
  Experiment experiment{{}, {ended_at(0, 0)}, Best{}};
  experiment.best->uncertainty.observable.fill(true);
  const Json best = to_json(experiment)["best"];
  CHECK(best["observable"] == Json::parse("[true, true, true, null, null, null]"));
  CHECK(best["sigma_by_curvature"] == Json::parse("[0.0, 0.0, 0.0, null, null, null]"));
  experiment.cell.degrees_of_freedom = 6;
  CHECK(to_json(experiment)["best"]["sigma_by_bootstrap"][5] == 0);
}

TEST_CASE("a result that cannot be written is refused beforehand, and nothing is left behind") {
  const test::TemporaryFolder folder;
  CHECK(ResultFile::at(folder.path() / "missing" / "result.json").error().code == "write_failed");
  CHECK(ResultFile::at(folder.path()).error().context.find("is a folder") != std::string::npos);
  CHECK(ResultFile::at(folder.path() / "result.json"));
  CHECK(std::filesystem::is_empty(folder.path()));
  Json none;
  test::require_ok(test::require_ok(ResultFile::at("")).write(none, true));
}

TEST_CASE("an older result stays until there is a newer one, behind a symbolic link too") {
  const test::TemporaryFolder folder;
  const auto link = folder.path() / "link.json", target = folder.path() / "target.json";
  std::filesystem::create_symlink("target.json", link);
  for (const bool exists : {false, true}) {
    if (exists) std::ofstream(target) << "older";
    const auto file = test::require_ok(ResultFile::at(link));
    CHECK(std::filesystem::exists(target) == exists);
    Json json = {{"kind", "curve"}, {"complete", true}};
    test::require_ok(file.write(json, false));
    CHECK(std::filesystem::is_symlink(link));
    std::ostringstream written;
    written << std::ifstream(target).rdbuf();
    CHECK(written.str() == "{\n \"kind\": \"curve\",\n \"complete\": false\n}\n");
  }
}

TEST_CASE("a result is not written where a link leads that another user has made, or that has its name meanwhile") {
  const test::TemporaryFolder folder;
  const auto link = folder.path() / "link.json", target = folder.path() / "target";
  std::ofstream(target) << "untouched";
  for (const char* name : {"result.json.part", "result.json.trial", "result.json.trial.part"})
    std::filesystem::create_symlink("target", folder.path() / name);
  Json json = Json::object();
  test::require_ok(test::require_ok(ResultFile::at(folder.path() / "result.json")).write(json, true));
  CHECK(std::filesystem::file_size(target) == 9);

  std::filesystem::create_symlink("target", link);
  if (lchown(link.c_str(), 65534, 65534) != 0) return test::skip("only root can give a link to somebody else");
  CHECK(ResultFile::at(link).error().context.find("a link that another user has made") != std::string::npos);
}

TEST_CASE("a pipe stays a pipe, and gets the complete result alone") {
  const test::TemporaryFolder folder;
  const auto pipe = folder.path() / "pipe";
  REQUIRE(mkfifo(pipe.c_str(), 0600) == 0);
  const int ours = open(pipe.c_str(), O_RDWR | O_NONBLOCK);  // so that nobody waits for the other end
  REQUIRE(ours >= 0);
  const auto file = test::require_ok(ResultFile::at(pipe));
  Json json = Json::object();
  test::require_ok(file.write(json, false));
  test::require_ok(file.write(json, true));
  std::string read(100, '\0');
  read.resize(std::max<ssize_t>(::read(ours, read.data(), read.size()), 0));
  close(ours);
  CHECK(read == "{\n \"complete\": true\n}\n");
  CHECK(std::filesystem::is_fifo(pipe));
}
