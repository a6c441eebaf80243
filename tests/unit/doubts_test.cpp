#include "calib_eval/doubts.hpp"

#include <algorithm>
#include <functional>

#include "calib_eval/report.hpp"
#include "support/catch.hpp"
#include "support/simulated_drive.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::eval;

namespace {

Run ended_at(double roll_deg, double score = 1) {
  Run run;
  Vector6 delta = Vector6::Zero();
  delta[0] = roll_deg * radians_per_degree;
  run.end = perturbation(delta);
  run.result = SearchResult{};
  run.result->score_after = score;
  return run;
}

/// Searches of which the first is the best one, about which nothing is doubtful.
Experiment experiment_of(std::vector<Run> runs) {
  Experiment experiment{{}, std::move(runs), Best{}};
  experiment.best->uncertainty.observable.fill(true);
  return experiment;
}

constexpr int most_frames = 10;

/// Frames with true depth; `cloud` gives the number of the scan of each.
RecordingFrames recording(int frames, const std::function<int(int)>& cloud) {
  static const auto all = [] {
    test::SimulatedDrive drive(4, 480, 144);
    RecordingFrames recorded{drive.camera(), drive.T_camera_lidar(), {}, {}, {}, {}};
    for (int i = 0; i < most_frames; ++i)
      recorded.frames.push_back({std::to_string(i), FramePair{{}, {}, drive.scan(i)}, drive.depth(i)});
    return recorded;
  }();
  RecordingFrames recorded = all;
  recorded.frames.resize(static_cast<std::size_t>(frames));
  for (int i = 0; i < frames; ++i) recorded.frames[i].pair.scan = all.frames[cloud(i)].pair.scan;
  recorded.agreement = RecordingAgreement{.rank_correlation = 0.95};
  return recorded;
}

int own(int frame) { return frame; }

bool has(const Doubts& doubts, std::string_view code) {
  return std::ranges::find(doubts, code, &Doubt::code) != doubts.end();
}

}  // namespace

TEST_CASE("axes that are not observable and searches that failed are doubts") {
  Experiment experiment = experiment_of({ended_at(0), ended_at(0)});
  CHECK(doubts_of(experiment).empty());
  experiment.best->uncertainty.observable = {true, false, true, false, false, false};
  CHECK(doubts_of(experiment) == Doubts{{"axis_not_observable", "pitch is not observable from these frames"}});
  experiment.best->uncertainty.observable.fill(true);
  experiment.runs[1].result = fail(ErrorCode::search_failed, "nothing is in view");
  CHECK(doubts_of(experiment) ==
        Doubts{{"search_failures", "1 of 2 searches failed, the first with: nothing is in view"}});
}

TEST_CASE("searches of which most end elsewhere than at the recording's extrinsic are a doubt") {
  Experiment experiment{{}, {ended_at(0), ended_at(0)}, {}};
  CHECK(doubts_of(experiment).empty());
  experiment.runs[0] = ended_at(3);
  CHECK(doubts_of(experiment).empty());
  experiment.runs[1] = ended_at(3);
  CHECK(doubts_of(experiment) ==
        Doubts{{"unlike_recording",
                "only 0 of 2 searches end at the recording's extrinsic: a search over these frames is not to be "
                "believed, or that extrinsic is wrong"}});
}

TEST_CASE("searches that end in different places are a doubt, and so is one search alone") {
  CHECK(doubts_of(experiment_of({ended_at(0.1), ended_at(0), ended_at(5)})).empty());
  const Doubts scattered =
      doubts_of(experiment_of({ended_at(0), ended_at(2), ended_at(4), ended_at(0.1), ended_at(8)}));
  CHECK(scattered[0] == Doubt{"not_repeatable", "only 2 of 5 searches end where the one with the best score does"});
  // Alike, but not at the recording's extrinsic: repeatable.
  CHECK(codes_of(doubts_of(experiment_of({ended_at(3), ended_at(3.1), ended_at(2.9)}))) == "unlike_recording");
  CHECK(codes_of(doubts_of(experiment_of({ended_at(0)}))) == "not_repeatable");
}

TEST_CASE("a best search that ends at a limit is a doubt") {
  Experiment experiment = experiment_of({ended_at(0), ended_at(0)});
  experiment.runs[0].result->ends_at_limit = true;
  experiment.runs[0].result->reason = "ends at the limit of yaw";
  CHECK(doubts_of(experiment) == Doubts{{"axis_at_limit", "the search with the best score ends at the limit of yaw"}});
}

TEST_CASE("few frames are a doubt, and ten are not few") {
  CHECK(codes_of(doubts_of(recording(4, own))) == "few_frames");
  CHECK(doubts_of(recording(most_frames, own)).empty());
}

TEST_CASE("depth that does not grow with range is a doubt, where the recording says and where the searches end") {
  RecordingFrames recorded = recording(most_frames, own);
  recorded.agreement->rank_correlation = 0.31;
  CHECK(codes_of(doubts_of(recorded)) == "low_agreement");
  Experiment experiment = experiment_of({ended_at(0), ended_at(0)});
  experiment.runs[0].result->T_camera_lidar = recorded.T_camera_lidar;
  CHECK(doubts_of(experiment, recorded).empty());
  for (auto& frame : recorded.frames)
    for (float& inverse : frame.depth.inverse_depth) inverse = inverse > 0 ? 1 / inverse : 0;
  CHECK(codes_of(doubts_of(experiment, recorded)) == "low_agreement");
}

TEST_CASE("an extrinsic that is probably another convention is a doubt") {
  RecordingFrames recorded = recording(most_frames, own);
  recorded.T_camera_lidar = recorded.T_camera_lidar.inverse();
  const Doubts doubts = doubts_of(recorded);
  REQUIRE(has(doubts, "extrinsic_suspect"));
  CHECK_THAT(std::ranges::find(doubts, "extrinsic_suspect", &Doubt::code)->words,
             Catch::Matchers::StartsWith("the recording's extrinsic does not go with the depth"));
}

TEST_CASE("a cloud whose layout its reader has remarked on is a doubt, and another remark is none") {
  RecordingFrames recorded = recording(most_frames, own);
  recorded.frames[3].pair.scan.notes.remarks = {{ErrorCode::malformed_row_step, "row_step is 0"}};
  CHECK(doubts_of(recorded).empty());
  recorded.frames[3].pair.scan.notes.remarks.push_back({ErrorCode::cloud_layout, "looks like float32x5"});
  CHECK(doubts_of(recorded) == Doubts{{"layout_in_doubt", "cloud of frame 3: looks like float32x5"}});
}

TEST_CASE("clouds of other frames are a doubt where depth tells frames apart, and only there") {
  const auto others = [](int frame) { return (frame + 3) % most_frames; };
  CHECK(doubts_of(recording(most_frames, others)) ==
        Doubts{{"pairing_suspect",
                "the depth of frames agrees better with the clouds of 3 frames earlier than with their own: images and "
                "clouds may not belong together"}});
  const PairingContrast right = pairing_contrast(recording(most_frames, own));
  CHECK(right.can_tell());
  CHECK(right.best_shift == 0);
  CHECK_FALSE(right.suspect());
  // A vehicle that stands: any cloud fits as well.
  RecordingFrames standing = recording(most_frames, own);
  for (auto& frame : standing.frames) {
    frame.pair.scan = standing.frames[0].pair.scan;
    frame.depth = standing.frames[0].depth;
  }
  CHECK_FALSE(pairing_contrast(standing).can_tell());
  CHECK(doubts_of(standing).empty());
  // Slow traffic: neighbours show the same scene, and a shift by one frame is no better than none.
  RecordingFrames slow = recording(most_frames, own);
  const RecordingFrames quick = slow;
  for (int i = 0; i < most_frames; ++i) {
    slow.frames[i].depth = quick.frames[i / 2 * 2].depth;
    slow.frames[i].pair.scan = quick.frames[(i + 1) % most_frames / 2 * 2].pair.scan;
  }
  CHECK_FALSE(pairing_contrast(slow).suspect());
  // Depth that does not agree with any cloud says nothing about which is the right one.
  RecordingFrames unrelated = recording(most_frames, others);
  unrelated.agreement->rank_correlation = 0.1;
  CHECK(codes_of(doubts_of(unrelated)) == "low_agreement");
}

TEST_CASE("doubts are told by code and words in JSON, and each code once in a line") {
  const Doubts doubts{{"few_frames", "3 frames"}, {"axis_not_observable", "x"}, {"axis_not_observable", "y"}};
  CHECK(codes_of(doubts) == "few_frames, axis_not_observable");
  CHECK(codes_of({}).empty());
  CHECK(to_json(doubts)[0] == Json{{"code", "few_frames"}, {"words", "3 frames"}});
  CHECK(to_json(doubts).size() == 3);
}
