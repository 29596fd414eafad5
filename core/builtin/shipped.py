"""The manifests of the shipped artefacts, by the folder's name: their digests
(`core.surrogate.artefact.whole_of`), so that the release itself says what was shipped with it.

A model that is built anew and shipped has its own here.
"""

WHOLE = {
    "rotor_blade_model": "68942770f0597bc04a3216ab57e64092d158029c9bda29fa335004ded60a0e43",
    "rotor_blade_wide_model": "8d6cdb90a4173e9f2cebc62ee132e39de5739d642c0c6f6bb5a39de2992fdfa9",
}
