"""Every call by its name: what `Client` and `AsyncClient` have in common."""

from __future__ import annotations

from typing import Any

from service.client import answers as _answers
from service.client import beliefs as _beliefs
from service.client import diagnoses as _diagnoses
from service.client import files as _files
from service.client import frames as _frames
from service.client import models as _models
from service.client import readings as _readings
from service.client import rotors as _rotors
from service.client import webhooks as _webhooks
from service.client.steps import call, pages, stream


class Calls:
    """The methods of both clients; each is written once, as steps, in the module of its noun."""

    ready = call(_rotors.ready)
    models = call(_models.models)
    model = call(_models.model)
    surface = call(_models.surface)
    register = call(_models.register)
    upload_model = call(_models.upload_model)
    create_rotor = call(_rotors.create_rotor)
    rotors = pages(_rotors.rotors, _answers.RotorListed)
    rotor = call(_rotors.rotor)
    set_policy = call(_rotors.set_policy)
    versions = pages(_rotors.versions, _answers.KeptVersion)
    blades = pages(_rotors.blades, _answers.BladeAtOneHour)
    add_blade = call(_rotors.add_blade)
    retire_blade = call(_rotors.retire_blade)
    retry = call(_rotors.retry)
    wait_for = call(_rotors.wait_for)
    wait_sealed = call(_rotors.wait_sealed)
    events = stream(_rotors.events, dict[str, Any])
    post_inspections = call(_readings.post_inspections)
    post_csv = call(_readings.post_csv)
    post_sensorthings = call(_readings.post_sensorthings)
    retract = call(_readings.retract)
    inspections = pages(_readings.inspections, _answers.Inspection)
    inspection = call(_readings.inspection)
    readings_csv = call(_readings.readings_csv)
    readings_parquet = call(_readings.readings_parquet)
    readings_sensorthings = call(_readings.readings_sensorthings)
    residuals = call(_readings.residuals)
    posterior = call(_beliefs.posterior)
    prediction = call(_beliefs.prediction)
    prediction_csv = call(_files.prediction_csv)
    prediction_sensorthings = call(_files.prediction_sensorthings)
    life = call(_beliefs.life)
    rotor_life = call(_beliefs.rotor_life)
    series = pages(_beliefs.series, _answers.SeriesRow)
    draws = call(_beliefs.draws)
    draws_netcdf = call(_files.draws_netcdf)
    draws_arviz = call(_files.draws_arviz)
    field = call(_beliefs.field)
    field_vtu = call(_files.field_vtu)
    field_pvd = call(_files.field_pvd)
    field_npz = call(_files.field_npz)
    field_arrow = call(_files.field_arrow)
    field_series = call(_files.field_series)
    plan = call(_beliefs.plan)
    readings_frame = call(_frames.readings_frame)
    prediction_frame = call(_frames.prediction_frame)
    blades_frame = call(_frames.blades_frame)
    residuals_frame = call(_frames.residuals_frame)
    draws_frame = call(_frames.draws_frame)
    field_xarray = call(_frames.field_xarray)
    diagnose = call(_diagnoses.diagnose)
    diagnoses = pages(_diagnoses.diagnoses, _answers.DiagnosisListed)
    diagnosis = call(_diagnoses.diagnosis)
    cancel_diagnosis = call(_diagnoses.cancel_diagnosis)
    report = call(_diagnoses.report)
    adopt = call(_diagnoses.adopt)
    back_out = call(_diagnoses.back_out)
    adoptions = pages(_diagnoses.adoptions, _answers.Adoption)
    create_webhook = call(_webhooks.create_webhook)
    webhook = call(_webhooks.webhook)
    delete_webhook = call(_webhooks.delete_webhook)
    deliveries = pages(_webhooks.deliveries, _answers.Delivery)
    retry_delivery = call(_webhooks.retry_delivery)
