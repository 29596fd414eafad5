"""What a blade's readings tell of a shift, once its own parameters have gone where they can.

Normal priors of covariance P leave Q = (V + J P Jᵀ)⁻¹ of it. Priors with bounds leave more in
blades that lean on them, and nothing but the particles knows how much: by Louis' identity
V⁻¹ − V⁻¹ Cov[f] V⁻¹ where that is more than Monte-Carlo error (`information`), and by the score
itself where it is less (`bounded`): a score's variance is its information (Bartlett's identity).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from core.prior import Prior

Array = NDArray[np.float64]
FAINT, CUT, ENDS = 0.25, 3.0, 1.0
BOX = 4.0  # sds: a prior that is no wider than so many is made by its ends
SURE = 3.0  # standard errors


def given(off: Array, f: Array, w: Array) -> Array:
    """Rows f (N, n) less what goes with the shared parameters, off (N, s), both without means.

    By regression: given these the blade's own parameters move so that the answers stay at the
    readings, and derivatives by the shared ones alone would leave all of that in.
    """
    root = np.sqrt(w)[:, None]
    return np.asarray(f - off @ np.linalg.lstsq(root * off, root * f, rcond=1e-9)[0])


def information(typical: Array, spread: Array, off: Array, w: Array) -> Array:
    """Q (n, n) of one blade, given the shared parameters.

    spread  J P^½ (n, l): change of the rows by a prior sd of each of its own parameters
    off     the rows at the particles given the shared parameters (`given`), (N, n)

    Normal priors would leave (V + J P Jᵀ)⁻¹, and no prior of the same variance leaves less. One
    with bounds leaves more, in blades that lean on them: by Louis' identity V⁻¹ − V⁻¹ Cov[f] V⁻¹,
    a small difference of large numbers, which counts where it is `SURE` standard errors above.
    """
    root = np.sqrt(typical)
    scaled = spread / root[:, None]
    value, vector = np.linalg.eigh(np.linalg.inv(np.eye(len(root)) + scaled @ scaled.T))
    along = (off / root) @ vector
    left = 1.0 - w @ along**2
    error = (1.0 - left) * np.sqrt(2.0 * (w @ w))
    value = np.where(left > value + SURE * error, np.minimum(left, 1.0), value)
    return np.asarray((vector * value) @ vector.T / np.outer(root, root))


def made_by_ends(prior: Prior) -> bool:
    """Whether a prior is a box rather than a bell.

    >>> made_by_ends(Prior("uniform", 0.0, 1.0)), made_by_ends(Prior("normal", -3.0, 3.0, 0.0, 1.0))
    (True, False)
    """
    u = prior.to_u(prior.quantile((np.arange(200) + 0.5) / 200))
    low, high = prior.box
    return bool(high - low < BOX * u.std())


def bounded(seen: Array, typical: Array, q: Array, box: bool = False) -> Array:
    """Q (n, n), but along a direction in which it is faint, at least what `CUT` sds of q say.

    box  whether a prior of the blade's own parameters is one (`made_by_ends`): `ENDS` sds then

    Faint is what is left less than `FAINT` of what it would be without the blade's own parameters,
    1 / V (typical, (n,)). They imitate nearly all there, by their priors' variances; where a blade
    leans on a bound they cannot, and q along it is many sds of what Q says (8 in one blade of a
    hundred, which looked like an effect of that blade, and made the null of all others wide).

    Under uniform priors all that faint directions tell is told by the ends: of a hundred blades q²
    along them is 2.3 times what a normal prior of the same variance says, and 43² times in a blade
    in the corner of three, which was scanned twice. What remains of the priors shrinks there with
    the square of the distance, and 1.4 sds are left of the 43 by that.
    """
    root = np.sqrt(typical)
    value, vector = np.linalg.eigh(seen * np.outer(root, root))
    along = vector.T @ (q * root)
    least = (along / (ENDS if box else CUT)) ** 2
    value = np.where(value < FAINT, np.maximum(value, least), value)
    return np.asarray((vector * value) @ vector.T / np.outer(root, root))
