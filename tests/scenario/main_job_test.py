"""The main job on the simulated vehicle: a knock is noticed, corrected and recorded."""

import os

import pytest
from drive import Drive, difference

KNOCKS = {"roll": "0.5,0,0", "pitch": "0,0.5,0", "yaw": "0,0,0.5"}
if int(os.environ.get("CALIBD_TEST_SLOWDOWN", "1")) > 1:
    KNOCKS = {"yaw": KNOCKS["yaw"]}  # the sanitizers look at code, which is the same for every axis


@pytest.mark.parametrize("knock", KNOCKS.values(), ids=KNOCKS.keys())
def test_half_a_degree_about_any_axis_is_corrected(bin_dir, tmp_path, dds_domain, knock):
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", "--knock-deg", knock, "--after-frames", 45) as drive:
        error_deg = drive.knocked_and_corrected(largest_error_deg=0.2, most_pairs_to_drift=10)
        print(f"{knock}: {error_deg:.3f} degrees from the truth")
        assert drive.verdicts()[0] == "calibrated" and drive.verdicts().count("drifted") == 1


def test_an_extrinsic_that_is_wrong_from_the_start_is_corrected(bin_dir, tmp_path, dds_domain):
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", "--knock-deg", "0,1,-1", "--after-frames", 0) as drive:
        after = drive.wait_for(lambda pair: pair["record"]["sequence"] > 1, 120)
        error_deg, _ = difference(after["T_camera_lidar"], drive.truth()[0])
        assert error_deg <= 0.2, drive.log()
        # Never was it called calibrated while it was not.
        assert "calibrated" not in drive.verdicts(), drive.log()
