"""Chapter 4: the curves pass through the ratios, and the ratios through a closed form."""

from __future__ import annotations

import numpy as np
import pytest

from compendium.experiments import chapter_4


@pytest.mark.parametrize("disc", ["neo-Hooke", "Hooke, no pressure"])
def test_a_curve_passes_through_its_ratios(disc: str) -> None:
    """One is solved for the depth, the other for the modulus."""
    curve = chapter_4.modulus_ratio_curve(disc)
    for depth in (0.1, 0.4):
        # Straight lines between 16 points miss a curve that bends this little by less than 0.5 %.
        along = np.interp(depth, curve["depth"], curve["ratio"])
        assert chapter_4.modulus_ratio(disc, depth) == pytest.approx(along, rel=5e-3)


def test_a_slack_disc_has_no_modulus_above_its_own_sag() -> None:
    """Meridians longer than the radius hang by themselves, whatever the modulus is."""
    # An inextensible cone of this slack is √(1/0.95² − 1) = 0.33 of the radius deep.
    with pytest.raises(ValueError, match="depth must be one that some modulus gives"):
        chapter_4.modulus_ratio("rim drawn in by 5 %", 0.1)
    assert chapter_4.modulus_ratio_curve("rim drawn in by 5 %")["depth"].min() > 0.25
