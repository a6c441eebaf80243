"""clang-tidy, as .clang-tidy says, over the sources that read what comes from outside: all of libcalib, daemon and tools
would take two cores ten minutes."""

import concurrent.futures
import os
import shutil
import subprocess

import pytest
from compile_flags import all_flags

READ_FROM_OUTSIDE = {
    "libcalib/src": "axis_words chain claim cloud_layout config_node depth_model file image_codec image_header json_fields model_file network_image record "
                    "record_signature sha256 signature status store store_outbox wall_time",
    "daemon": "chain_head config control evidence_file feed ledger ledger_keys",
    "daemon/uplink": "calibd_request delivery file_sink uplink_config",
    "daemon/dds": "bus compressed_probe decode decode_camera_info decode_cloud decode_depth decode_image decode_motion discovery image_bound names "
                  "window",
    "tools/calibctl": "control_client",
    "tools/dataset": "cloud_file depth_files encoded_image frames_by_name image_file kitti_360 kitti_calibration kitti_object kitti_raw "
                     "list nuscenes pcd_file recording rosbag2",
    "tools/dataset/bag": "bag bag_frames bag_storage bag_topics byte_source decompress frame_pairs mcap_file ros_message sqlite_bag "
                         "transform_tree",
}


def test_sources_that_read_from_outside_pass_clang_tidy(source_dir, bin_dir):
    tidy = shutil.which("clang-tidy-16")
    if tidy is None:
        pytest.skip("clang-tidy-16 is not installed")
    flags = all_flags(bin_dir)
    sources = [source_dir / folder / f"{name}.cpp" for folder, names in READ_FROM_OUTSIDE.items() for name in names.split()]
    assert not [str(source) for source in sources if str(source) not in flags], "renamed?"

    def findings(source):
        done = subprocess.run([tidy, "--quiet", source, "--", *flags[str(source)][1]], capture_output=True, text=True, check=False)
        return done.stdout if done.returncode != 0 else ""

    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as threads:
        found = "\n".join(filter(None, threads.map(findings, sources)))
    assert not found, found
