"""The main job on recorded frames: a calibrated vehicle stays calibrated until it is knocked."""

from drive import Drive

NULL_PAIRS = 200


def test_a_recorded_drive_stays_calibrated_until_it_is_knocked(bin_dir, tmp_path, dds_domain, kitti_drive):
    with Drive(bin_dir, tmp_path, dds_domain, "calib-replay", kitti_drive, "--loop", "--knock-deg", "0,0,1",
               "--after-frames", NULL_PAIRS + 60) as drive:
        null = drive.wait_for(lambda pair: pair["evaluated"] >= NULL_PAIRS, 180)
        assert "drifted" not in drive.verdicts() and null["record"]["sequence"] == 1, drive.log()
        error_deg = drive.knocked_and_corrected(largest_error_deg=0.35, most_pairs_to_drift=10)
        print(f"{error_deg:.3f} degrees from the truth")
        drive.wait_for(lambda pair: pair["verdict"] == "calibrated", 60)
        assert drive.verdicts().count("drifted") == 1
