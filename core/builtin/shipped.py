"""The manifests of the shipped artefacts, by the folder's name: their digests
(`core.surrogate.artefact.whole_of`), so that the release itself says what was shipped with it.

A model that is built anew and shipped has its own here.
"""

WHOLE = {
    "rotor_blade_model": "68942770f0597bc04a3216ab57e64092d158029c9bda29fa335004ded60a0e43",
    "rotor_blade_wide_model": "42469e0d865b78fefa39b92232650f48226c1d9e5879c9fd361859b1e17f6b3a",
}
