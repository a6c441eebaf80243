"""A vehicle that weaves, and a LiDAR that measures with its cameras or after them: pairs that show a turn instead of the
extrinsic are skipped, where it is known how fast the vehicle turns."""

import pytest
from drive import Drive

# Ten degrees a second and more, but for the moments in which the wheel goes over to the other side.
WEAVING = ["--width", "480", "--height", "144", "--lidar-step-deg", "0.3", "--lidar-fov-deg", "110", "--weave-deg", "10"]


def quick(text):
    return text.replace("500ms", "250ms")


def test_a_late_cloud_is_skipped_in_a_turn_and_evaluated_out_of_it(bin_dir, tmp_path, dds_domain, slowdown):
    options = ["--motion-topic", "/imu/data", "--cloud-late-ms", "40"]
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", *WEAVING, *options, rate_hz=5, configure=quick) as drive:
        pair = drive.wait_for(lambda pair: pair["skipped"].get("motion", 0) >= 10 and pair["evaluated"] >= 1, 90 * slowdown)
        assert pair["evaluated"] < pair["skipped"]["motion"], pair
        assert pair["inputs"]["time_difference_ms"] == pytest.approx(40)
        assert pair["inputs"]["motion"]["topic"] == "/imu/data" and pair["inputs"]["motion"]["age_s"] < 10 * slowdown
        assert "Motion" in drive.ctl("status", "front").stdout
        turning = drive.wait_for(lambda pair: pair["reason"].startswith("motion:"), 60 * slowdown)
        assert "degrees" in turning["reason"]


def test_no_pair_of_one_instant_is_skipped_however_the_vehicle_turns(bin_dir, tmp_path, dds_domain, slowdown):
    options = ["--motion-topic", "/odom", "--motion-as", "odometry"]
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", *WEAVING, *options, rate_hz=5, configure=quick) as drive:
        pair = drive.wait_for(lambda pair: pair["evaluated"] >= 10, 90 * slowdown)
        assert "motion" not in pair["skipped"] and pair["inputs"]["motion"]["age_s"] is not None, pair


def test_motion_that_is_configured_and_silent_is_told_and_nothing_is_believed(bin_dir, tmp_path, dds_domain, slowdown):
    def configure(text):
        return quick(text) + "    motion: {topic: /nobody, type: imu}\n"

    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", *WEAVING, rate_hz=5, configure=configure) as drive:
        pair = drive.wait_for(lambda pair: pair["reason"].startswith("motion_unknown"), 60 * slowdown)
        assert (pair["verdict"], pair["evaluated"]) == ("not_evaluated", 0)
        assert pair["inputs"]["motion"] == {"topic": "/nobody", "age_s": None}
