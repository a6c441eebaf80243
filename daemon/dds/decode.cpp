#include "dds/decode.hpp"

#include <string_view>

namespace calib {

Result<Timestamp> decode_stamp(const std_msgs_msg_dds__Header_& header) {
  if (header.stamp.sec < 0 || header.stamp.nanosec >= 1'000'000'000)
    return fail(ErrorCode::malformed_stamp, "header.stamp is " + std::to_string(header.stamp.sec) + " s and " +
                                                std::to_string(header.stamp.nanosec) +
                                                " ns, where sec >= 0 and nanosec < 1000000000 are allowed");
  return std::chrono::seconds(header.stamp.sec) + std::chrono::nanoseconds(header.stamp.nanosec);
}

MessageNotes notes_of(const std_msgs_msg_dds__Header_& header) {
  std::string_view frame_id = header.frame_id != nullptr ? header.frame_id : "";
  if (frame_id.starts_with('/')) frame_id.remove_prefix(1);  // as ROS 1 had it; tf2 takes none
  return {.frame_id = escape_control(frame_id.substr(0, MessageNotes::longest_frame_id)), .remarks = {}};
}

void add_remark(MessageNotes& notes, ErrorCode code, std::string what) {
  constexpr std::size_t most = 8;
  if (notes.remarks.size() < most) notes.remarks.push_back({code, std::move(what)});
}

}  // namespace calib
