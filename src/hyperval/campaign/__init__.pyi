"""A campaign: its file read and looked over, run, judged; its record, its draft, the power of its criteria."""

from .files_needed import WRONG, Item, dry_run, overview, summary
from .forward import predict_to_folder
from .pictures import expected_maps, scene_content
from .power import (
    DetectedBy,
    InjectedError,
    Power,
    PowerTable,
    accepted_table,
    campaign_power,
    gate_values,
    own_files,
    power_table,
    write_power_table,
)
from .products import (
    ObservedCampaign,
    completed_scenario,
    merged_predictions,
    observe_campaign,
    without_circular_spectra,
)
from .provenance import command_without_output, package_versions, record_of, source_revision
from .run import find_unchanged_run, observe, run_campaign, validate
from .schema import Campaign, DayScenarios, Job, load_job, load_jobs, load_scenarios, read_jobs
from .starter import StarterSources, starter_campaign

__all__ = [
    "WRONG", "Campaign", "DayScenarios", "DetectedBy", "InjectedError", "Item", "Job", "ObservedCampaign", "Power",
    "PowerTable", "StarterSources", "accepted_table", "campaign_power", "command_without_output", "completed_scenario",
    "dry_run", "expected_maps", "find_unchanged_run", "gate_values", "load_job", "load_jobs", "load_scenarios",
    "merged_predictions", "observe", "observe_campaign", "overview", "own_files", "package_versions", "power_table",
    "predict_to_folder", "read_jobs", "record_of", "run_campaign", "scene_content", "source_revision",
    "starter_campaign", "summary", "validate", "without_circular_spectra", "write_power_table",
]  # fmt: skip
