#pragma once

#include <chrono>
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "calib/geometry.hpp"
#include "calib/sha256.hpp"
#include "calib/signature.hpp"
#include "calib/wall_time.hpp"

namespace calib {

/// What was decided about an extrinsic.
enum class Decision {
  initial,      // taken from the configuration; nothing was computed
  accepted,     // computed, passed the gates, now in force
  proposed,     // computed, passed the gates, waiting for `calibctl accept`
  rejected,     // computed, a gate said no; the extrinsic before it stays in force
  rolled_back,  // an earlier record's extrinsic, in force again
  baseline,     // the baseline of the extrinsic in force was learned; that extrinsic stays in force
  key_changed,  // nothing about an extrinsic: another key signs from the next record on
};

/// That another key signs all records after this one. The record itself is signed with both keys: with the previous
/// one, so that nobody else can name a successor; and with the next one, so that it is there, and nobody can name a key
/// that is not theirs.
struct KeyChange {
  PublicKey previous, next;
  /// The previous key was not at hand: the record is signed with the next one alone. Only who trusts that one, or one
  /// after it, believes the record.
  bool previous_lost = false;
  /// Somebody else may have had the previous key: its records from this number on may be theirs.
  std::optional<std::uint64_t> doubted_from;
};

/// What a person had to say to a request.
struct Comment {
  /// As `check_comment` lets it pass; empty where nothing was said.
  std::string text;
  /// The login of that person, which sudo does not change: `uid:<number>` as the kernel told it, or
  /// `client:uid:<number>` as the person's program told it; empty where neither is known. Only with a text, or of a
  /// change of keys.
  std::string login;
};

/// One signed decision about a pair's extrinsic. The text of the format is proto/record.md.
struct CalibrationRecord {
  std::string vehicle;
  std::string pair;
  /// Counts the records of one store, over all pairs, from 1 without a gap.
  std::uint64_t sequence = 0;
  /// SHA-256 (lower-case hex) of the canonical bytes of record `sequence - 1`; 64 zeros for the first.
  std::string previous_sha256;
  Decision decision = Decision::initial;
  /// Why, in words; the failed gate when rejected.
  std::string reason;
  /// `calibd`, `configuration` or `uid:<number>` of the person at the control socket.
  std::string asked_by;
  Comment comment;
  /// The extrinsic that this record is about: in force after it, unless proposed or rejected. Of a baseline, in force
  /// before it too.
  RigidTransform T_camera_lidar = RigidTransform::Identity();
  /// The extrinsic in force when the decision was taken.
  RigidTransform T_camera_lidar_before = RigidTransform::Identity();
  /// One standard deviation, LiDAR axes (rad, m); none where nothing was computed.
  std::optional<Vector6> sigma;
  /// Objective (nats ratio) over the frames used, before and after; none where nothing was computed.
  struct Score {
    double before = 0, after = 0;
    double held_back_before = 0, held_back_after = 0;
  };
  std::optional<Score> score;
  /// The baseline at the extrinsic, learned from good pairs: every later verdict is relative to it. Of decision
  /// `baseline`, and of no other.
  struct Baseline {
    std::uint64_t pairs = 0;
    /// Slope of the score at the extrinsic, per rad and m along the LiDAR's axes: mean, and covariance between pairs.
    Vector6 slope = Vector6::Zero();
    Matrix6 slope_covariance = Matrix6::Zero();
    Vector6 slope_correlation = Vector6::Zero();  // of one pair's with the next one's
    /// Change of the slopes (rows) when the LiDAR moves along each axis (columns), per rad and m: mean, and standard
    /// deviation of its diagonal between pairs. `sensitivity` in JSON.
    Matrix6 sensitivity = Matrix6::Zero();
    Vector6 sensitivity_deviation = Vector6::Zero();
    /// By how much the score exceeds the mean of its twelve neighbours. `prominence` in JSON.
    double prominence = 0, prominence_deviation = 0, prominence_correlation = 0;
    double score = 0, score_deviation = 0;
  };
  std::optional<Baseline> baseline;
  /// Of decision `key_changed`, and of no other. Such a record has no pair, and nothing that belongs to one.
  std::optional<KeyChange> key_change;
  /// Sensor time stamps (nanoseconds) of the images used, fit and held back.
  std::vector<std::int64_t> frame_stamps_ns;
  /// SHA-256 (lower-case hex) of the configuration file's bytes and of the program's build id.
  std::string configuration_sha256;
  std::string software_version;
  std::string software_sha256;
  /// Digest of what the pair's evidence is measured with: its sensors, lens and depth source as configured, the depth
  /// model, the software. Two records with the same one may be compared. Empty in a record of schema 1, which lacks it.
  std::string evidence_sha256;
  /// When it was decided: UTC, and the boot it happened in with the time since that boot.
  WallTime wall_time{};
  std::string boot_id;
  std::chrono::nanoseconds boot_time{};
};

[[nodiscard]] std::string_view to_string(Decision decision);
/// Whether such a record's extrinsic is in force from then on: `initial`, `accepted` and `rolled_back`.
[[nodiscard]] bool puts_in_force(Decision decision);

/// `{"translation_m":[x,y,z],"quaternion_xyzw":[x,y,z,w]}`, the one form of a transform in every JSON text.
[[nodiscard]] nlohmann::json transform_json(const RigidTransform& transform);

/// `json` in the canonical form of proto/record.md, which is what is signed.
[[nodiscard]] std::string canonical_json(const nlohmann::json& json);

/// What stands for the predecessor of the first record.
inline constexpr std::string_view no_previous_sha256 =
    "0000000000000000000000000000000000000000000000000000000000000000";

/// The bytes that are hashed, signed and stored: JSON, keys sorted, no white space, shortest numbers that
/// round-trip. Text that is not UTF-8 is written with U+FFFD in the place of what is wrong.
[[nodiscard]] std::string canonical_bytes(const CalibrationRecord& record);

/// Strict inverse of `canonical_bytes`: fails with `malformed_record` on an unknown or missing key, a wrong
/// type, or bytes that are not in canonical form.
[[nodiscard]] Result<CalibrationRecord> parse_record(std::string_view canonical);

/// Bytes of a comment.
inline constexpr std::size_t longest_comment = 1000;
/// Whether a comment is 1 to `longest_comment` bytes of UTF-8 without control characters. Fails with `bad_request`.
[[nodiscard]] Result<void> check_comment(std::string_view comment);

/// The name of an exported record, `000012.json`; its signature is beside it with `.minisig` added.
[[nodiscard]] std::string record_file_name(std::uint64_t sequence);

/// A record as it is kept: canonical bytes and the minisign signature file over them. A record of decision
/// `key_changed` has two signature files over the same bytes, one after the other: of the previous key, unless that is
/// lost, and of the next one.
struct SignedRecord {
  std::string canonical;
  std::string signature;
};

/// Fails with `malformed_record` when the record holds what could not be read back, e.g. a number that is not
/// finite.
[[nodiscard]] Result<SignedRecord> sign_record(const CalibrationRecord& record, const SigningKey& key);
/// One of decision `key_changed`; `previous` is null where that key is lost. Fails as `sign_record`.
[[nodiscard]] Result<SignedRecord> sign_key_change(const CalibrationRecord& record, const SigningKey* previous,
                                                   const SigningKey& next);

/// The record, when `key` alone signed exactly these bytes and it names the same sequence and predecessor.
/// `expected_previous_sha256` is `sha256_hex` of the record before it, or 64 zeros. Fails with
/// `bad_signature`, `wrong_key` ("signed by X, you have Y"), `broken_chain` or `malformed_record`. A change of keys is
/// for `ChainVerifier`, and fails with `broken_chain`.
[[nodiscard]] Result<CalibrationRecord> verify_record(const SignedRecord& record, const PublicKey& key,
                                                      std::string_view expected_previous_sha256,
                                                      std::uint64_t expected_sequence);
/// The record of these bytes, when it names this sequence and predecessor; whoever signed it.
[[nodiscard]] Result<CalibrationRecord> parse_link(std::string_view canonical,
                                                   std::string_view expected_previous_sha256,
                                                   std::uint64_t expected_sequence);

}  // namespace calib
