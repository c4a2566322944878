"""A campaign: its file read and looked over, run, judged; its record, its draft, the power of its criteria."""

from .files_needed import WRONG, Item, dry_run, overview, summary
from .forward import predict_to_folder
from .pictures import expected_maps, scene_content
from .power import (
    Injected,
    Power,
    PowerTable,
    Sight,
    accepted_table,
    campaign_power,
    gate_values,
    own_files,
    power_table,
    write_power_table,
)
from .products import Collected, collected, completed_scenario, merged_predictions, without_circular_spectra
from .provenance import command_without_output, package_versions, record_of, source_revision
from .run import observe, run_campaign, unchanged_run, validate
from .schema import Campaign, DayScenarios, Job, job_of, jobs_of, read_jobs, scenarios_of
from .starter import StarterSources, starter_campaign

__all__ = [
    "WRONG", "Campaign", "Collected", "DayScenarios", "Injected", "Item", "Job", "Power", "PowerTable", "Sight",
    "StarterSources", "accepted_table", "campaign_power", "collected", "command_without_output", "completed_scenario",
    "dry_run", "expected_maps", "gate_values", "job_of", "jobs_of", "merged_predictions", "observe", "overview",
    "own_files", "package_versions", "power_table", "predict_to_folder", "read_jobs", "record_of", "run_campaign",
    "scenarios_of", "scene_content", "source_revision", "starter_campaign", "summary", "unchanged_run", "validate",
    "without_circular_spectra", "write_power_table",
]  # fmt: skip
