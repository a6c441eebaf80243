"""The main job: a calibrated vehicle stays calibrated; a knock is noticed, corrected and recorded."""

import pytest
from drive import Drive, difference

NULL_PAIRS = 200


def knocked_and_corrected(drive, largest_error_deg, most_pairs_to_drift):
    """From the knock on: `drifted` in time, one accepted record near the truth, and calibrated again."""
    before = drive.wait_for_knock(200)
    assert before["verdict"] == "calibrated" and before["record"]["sequence"] == 1, drive.log()
    drifted = drive.wait_for(lambda pair: pair["verdict"] == "drifted", 60)
    # One pair may have been on its way through the pipeline when the knock was heard of.
    assert drifted["evaluated"] - before["evaluated"] <= most_pairs_to_drift + 1, drive.log()
    after = drive.wait_for(lambda pair: pair["record"]["sequence"] == 2, 120)
    error_deg, _ = difference(after["T_camera_lidar"], drive.truth()[0])
    assert error_deg <= largest_error_deg, drive.log()
    verified = drive.ctl("verify")
    assert verified.returncode == 0, verified.stdout + verified.stderr
    return before, drifted, after, error_deg


@pytest.mark.parametrize("knock", ["0.5,0,0", "0,0.5,0", "0,0,0.5"], ids=["roll", "pitch", "yaw"])
def test_half_a_degree_about_any_axis_is_corrected(bin_dir, tmp_path, dds_domain, knock):
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", "--knock-deg", knock, "--after-frames", 45) as drive:
        *_, error_deg = knocked_and_corrected(drive, largest_error_deg=0.2, most_pairs_to_drift=10)
        print(f"{knock}: {error_deg:.3f} degrees from the truth")
        assert drive.verdicts()[0] == "calibrated" and drive.verdicts().count("drifted") == 1


def test_a_recorded_drive_stays_calibrated_until_it_is_knocked(bin_dir, tmp_path, dds_domain, kitti_drive):
    with Drive(bin_dir, tmp_path, dds_domain, "calib-replay", kitti_drive, "--loop", "--knock-deg", "0,0,1",
               "--after-frames", NULL_PAIRS + 40) as drive:
        null = drive.wait_for(lambda pair: pair["evaluated"] >= NULL_PAIRS, 180)
        assert "drifted" not in drive.verdicts() and null["record"]["sequence"] == 1, drive.log()
        *_, error_deg = knocked_and_corrected(drive, largest_error_deg=0.35, most_pairs_to_drift=10)
        print(f"{error_deg:.3f} degrees from the truth")
        drive.wait_for(lambda pair: pair["verdict"] == "calibrated", 60)
        assert drive.verdicts().count("drifted") == 1
