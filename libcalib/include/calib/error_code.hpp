#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>

namespace calib {

// The one table of error codes. CODE(name) has its name as word; MALFORMED(name) is the enumerator `malformed_name`
// with the word `malformed:name`: a message that arrived over DDS and breaks its format or a bound. A word is part of
// the interface (status, records, control protocol, doctor, logs) and does not change once it is released.
// clang-format off
#define CALIB_ERROR_CODES(CODE, MALFORMED)                                                                       \
  /* libcalib: files and configuration */                                                                        \
  CODE(file_not_found) CODE(file_unreadable) CODE(file_too_large) CODE(write_failed)                             \
  CODE(config_not_found) CODE(bad_config)                                                                        \
  /* libcalib: geometry, cameras and pairs of samples */                                                         \
  CODE(bad_transform) CODE(bad_camera) CODE(extrinsic_implausible)                                               \
  CODE(sensor_silent) CODE(no_pair) CODE(right_image_missing) CODE(depth_missing) CODE(time_difference)          \
  CODE(motion_unknown)                                                                                           \
  /* libcalib: depth and the quality of a pair */                                                                \
  CODE(depth_failed) CODE(few_valid_depth) CODE(image_size_mismatch) CODE(motion) CODE(dark) CODE(saturated)     \
  CODE(low_texture) CODE(standing_still) CODE(low_overlap)                                                       \
  /* libcalib: drift, search and recalibration */                                                                \
  CODE(sensitivity_missing) CODE(unknown_objective) CODE(too_few_pairs) CODE(search_failed) CODE(cancelled)      \
  /* libcalib: signatures, records, store and status */                                                          \
  CODE(bad_key) CODE(bad_name) CODE(key_exists) CODE(key_not_found) CODE(key_not_written) CODE(key_permissions)  \
  CODE(bad_signature) CODE(wrong_key) CODE(broken_chain) CODE(malformed_record) CODE(record_not_found)           \
  CODE(store_failed) CODE(store_moved) CODE(store_not_found) CODE(store_version)                                 \
  CODE(bad_time) CODE(bad_verdict) CODE(malformed_status)                                                        \
  /* libcalib: why there is no verdict, beside what a pair is refused for */                                     \
  CODE(no_pair_yet) CODE(starting) CODE(stale) CODE(unresolved) CODE(learning) CODE(insufficient_power)          \
  /* daemon: messages of sensors */                                                                              \
  MALFORMED(stamp) MALFORMED(refused)                                                                            \
  MALFORMED(fields) MALFORMED(field_type) MALFORMED(field_bounds) MALFORMED(xyz) MALFORMED(point_step)           \
  MALFORMED(row_step) MALFORMED(cloud_size) MALFORMED(cloud_data)                                                \
  MALFORMED(image_size) MALFORMED(encoding) MALFORMED(step) MALFORMED(image_data)                                \
  MALFORMED(compressed_format) MALFORMED(compressed_size) MALFORMED(compressed_dimensions)                       \
  MALFORMED(compressed_scans) MALFORMED(compressed_metadata) MALFORMED(compressed_data)                          \
  MALFORMED(depth_encoding) MALFORMED(disparity_scale) MALFORMED(disparity_range) MALFORMED(valid_window)        \
  MALFORMED(intrinsics) MALFORMED(distortion) MALFORMED(roi) MALFORMED(angular_velocity)                         \
  MALFORMED(cloud_layout)                                                                                        \
  MALFORMED(uncalibrated)                                                                                        \
  MALFORMED(disparity_sign)                                                                                      \
  CODE(frame_id_mismatch)                                                                                        \
  CODE(image_bits)                                                                                               \
  CODE(camera_info_missing) CODE(camera_info_mismatch) CODE(duplicate_frame) CODE(out_of_memory)                 \
  /* daemon: DDS and service */                                                                                  \
  CODE(bad_interface) CODE(bad_topic) CODE(dds_failed)                                                           \
  CODE(bad_directory) CODE(control_socket) CODE(depth_model_refused) CODE(internal_error) CODE(malformed_alert)  \
  CODE(malformed_head) CODE(malformed_state) CODE(no_build_id) CODE(other_vehicle)                               \
  CODE(recalibration_failed) CODE(signals) CODE(snapshot_failed) CODE(too_few_files)                             \
  /* control protocol: what calibd refuses a request with, see proto/control.md */                               \
  CODE(bad_request) CODE(denied) CODE(failed) CODE(not_found) CODE(not_ready)                                    \
  /* tools: calibctl */                                                                                          \
  CODE(bad_socket) CODE(daemon_not_running) CODE(export_failed) CODE(file_exists) CODE(malformed_reply)          \
  CODE(no_answer)                                                                                                \
  /* tools: recordings */                                                                                        \
  CODE(calibration_malformed) CODE(calibration_missing) CODE(cloud_empty) CODE(cloud_unreadable)                 \
  CODE(cloud_layout)                                                                                             \
  CODE(depth_empty) CODE(depth_unreadable) CODE(frame_mismatch) CODE(frame_out_of_range) CODE(image_unreadable)  \
  CODE(recording_not_found) CODE(unknown_depth_kind)                                                             \
  /* tools: calib-eval, calib-sim and calib-replay */                                                            \
  CODE(bad_block) CODE(bad_knock) CODE(no_depth) CODE(no_end) CODE(no_motion) CODE(no_right_images)              \
  CODE(not_made) CODE(not_read) CODE(not_run) CODE(plot_missing) CODE(result_unreadable) CODE(stereo_missing)    \
  CODE(too_few_frames) CODE(unknown_axis)
// clang-format on

/// What went wrong, for a program. There is no enumerator for "nothing".
enum class ErrorCode : std::uint8_t {
#define CALIB_CODE(name) name,
#define CALIB_MALFORMED(name) malformed_##name,
  CALIB_ERROR_CODES(CALIB_CODE, CALIB_MALFORMED)
#undef CALIB_CODE
#undef CALIB_MALFORMED
};

/// Every code, in the order of the enumerators.
inline constexpr std::array all_error_codes{
#define CALIB_CODE(name) ErrorCode::name,
#define CALIB_MALFORMED(name) ErrorCode::malformed_##name,
    CALIB_ERROR_CODES(CALIB_CODE, CALIB_MALFORMED)
#undef CALIB_CODE
#undef CALIB_MALFORMED
};

/// The stable word of a code: snake_case, sometimes with a detail after a colon, e.g. `malformed:point_step`.
[[nodiscard]] std::string_view to_string(ErrorCode code);

/// The code of a word that came from outside; nothing for a word that this version does not know.
[[nodiscard]] std::optional<ErrorCode> parse_error_code(std::string_view word);

/// Whether a sensor's message broke its format or a bound: the codes `malformed:*`.
[[nodiscard]] bool is_malformed(ErrorCode code);

}  // namespace calib
