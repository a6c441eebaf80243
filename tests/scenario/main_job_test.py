"""The main job on the simulated vehicle: a knock is noticed, corrected and recorded."""

import pytest
from drive import Drive


@pytest.mark.parametrize("knock", ["0.5,0,0", "0,0.5,0", "0,0,0.5"], ids=["roll", "pitch", "yaw"])
def test_half_a_degree_about_any_axis_is_corrected(bin_dir, tmp_path, dds_domain, knock):
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", "--knock-deg", knock, "--after-frames", 45) as drive:
        error_deg = drive.knocked_and_corrected(largest_error_deg=0.2, most_pairs_to_drift=10)
        print(f"{knock}: {error_deg:.3f} degrees from the truth")
        assert drive.verdicts()[0] == "calibrated" and drive.verdicts().count("drifted") == 1
