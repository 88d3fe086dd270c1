"""Every figure that a page quotes: what it is, its bound, and the command that measures it again.

The text of a page relies on the bound, not on the digits: another machine, another version of a library or
an improvement may move a figure within it. Times have wide bounds, since machines differ and are shared.
"""

from benchmarks.figures import measurements
from benchmarks.figures.figure import Figure, Measurement

README_COMMANDS = "the README's `torchpi simulate` lines, then "

MEASUREMENTS = (
    Measurement(
        "stage",
        "python -m benchmarks.figures --only stage",
        (
            Figure("stage_reach_um", "µm", 8.0, 8.2, ".0f"),
            Figure("stage_loop_percent", "%", 13.5, 14.5, ".0f"),
        ),
        measurements.default_stage,
        about_s=2,
    ),
    Measurement(
        "diagnostic_set",
        "torchpi excite --for diagnosis --max_voltage_v 10 --max_rate_v_s 2000 --sample_rate_hz 10000",
        (Figure("diagnostic_set_s", "s", 45, 75, ".0f"),),
        measurements.diagnostic_set,
        about_s=1,
    ),
    Measurement(
        "piezo_stack",
        "python -m train fit --config configs/piezo_stack.yaml",
        (
            Figure("piezo_stack_um", "µm", 0, 0.25),
            Figure("piezo_stack_percent", "%", 0, 0.6, ".2f"),
            Figure("piezo_stack_two_stage_um", "µm", 0.3, 0.35),
            Figure("piezo_stack_plays_um", "µm", 0.45, 0.55),
            Figure("piezo_stack_ratio", "1", 0, 0.8, ".2f"),
            Figure("piezo_stack_forward_um", "µm", 0, 0.6, ".2f"),
        ),
        measurements.piezo_stack,
        about_s=15,
        needs_recordings=True,
    ),
    Measurement(
        "mirror",
        "python -m train fit --config configs/mirror.yaml, one realisation of each amplitude held out, then "
        "torchpi export, torchpi run and benchmarks/multi_axis_steps.py",
        (
            Figure("mirror_fit_s", "s", 0, 700, ".0f"),
            Figure("mirror_100_um", "µm", 0, 0.045, ".3f"),
            Figure("mirror_200_um", "µm", 0, 0.07, ".3f"),
            Figure("mirror_300_um", "µm", 0, 0.1, ".3f"),
            Figure("mirror_100_noise_um", "µm", 0.011, 0.012, ".3f"),
            Figure("mirror_200_noise_um", "µm", 0.0095, 0.0105, ".3f"),
            Figure("mirror_300_noise_um", "µm", 0.017, 0.019, ".3f"),
            Figure("mirror_step_us", "µs", 0, 4, ".2f"),
            Figure("mirror_inverse_us", "µs", 0, 40, ".0f"),
            Figure("mirror_tracking_percent", "%", 0, 1, ".2f"),
            Figure("mirror_coupling_percent", "%", 0, 0.1, ".2f"),
            Figure("mirror_linear_tracking_percent", "%", 0, 10, ".1f"),
            Figure("mirror_linear_coupling_percent", "%", 0, 10, ".1f"),
            *(Figure(f"mirror_loop_{number}_percent", "%", 0, 10, ".1f") for number in (1, 2, 3)),
            *(Figure(f"mirror_gain_{o}_{i}", "µm/V", 0, 10, ".2f") for o in (1, 2, 3) for i in (1, 2, 3)),
        ),
        measurements.mirror,
        about_s=560,
        needs_recordings=True,
    ),
    Measurement(
        "mirror_folds",
        "python benchmarks/mirror_folds.py",
        tuple(
            Figure(f"mirror_{kind}_{level}_um", "µm", 0, at_most, ".3f")
            for kind in ("median", "worst", "worst_noise")
            for level, at_most in ((100, 0.07), (200, 0.08), (300, 0.1))
        ),
        measurements.mirror_folds,
        about_s=3600,
        needs_recordings=True,
    ),
    Measurement(
        "mirror_without",
        "python benchmarks/mirror_folds.py --folds 4 --without 200mV",
        (
            Figure("mirror_without_um", "µm", 0, 0.13, ".3f"),
            Figure("mirror_without_worst_um", "µm", 0, 0.14, ".3f"),
            Figure("mirror_without_not_linear_um", "µm", 0, 0.07, ".3f"),
            Figure("mirror_between_um", "µm", 0.095, 0.105, ".3f"),
            Figure("mirror_between_percent", "%", 35, 50, ".0f"),
        ),
        measurements.mirror_without,
        about_s=560,
        needs_recordings=True,
    ),
    Measurement(
        "bouc_wen",
        "python -m train fit --config configs/bouc_wen.yaml",
        (
            Figure("bouc_wen_heldout_um", "µm", 7, 7.6),
            Figure("bouc_wen_noise_um", "µm", 7, 7.6),
            Figure("bouc_wen_mean_um", "µm", 3.5, 3.9),
            Figure("bouc_wen_mean_noise_um", "µm", 3.5, 3.9),
            Figure("bouc_wen_mass", "kg", 1.999, 2.001, ".4f"),
            Figure("bouc_wen_mass_half", "kg", 0, 0.001, ".4f"),
            Figure("bouc_wen_damping", "N s/m", 9.9, 10.1, ".2f"),
            Figure("bouc_wen_damping_half", "N s/m", 0, 0.1, ".2f"),
            Figure("bouc_wen_stiffness", "N/m", 49_900, 50_100, ",.0f"),
            Figure("bouc_wen_stiffness_half", "N/m", 0, 100, ".0f"),
            Figure("bouc_wen_alpha", "N/m", 49_900, 50_100, ",.0f"),
            Figure("bouc_wen_alpha_half", "N/m", 0, 100, ".0f"),
            Figure("bouc_wen_dissipation", "1/m", 798, 802, ".1f"),
            Figure("bouc_wen_dissipation_half", "1/m", 0, 2, ".1f"),
            Figure("bouc_wen_hardening", "1/m", 1097, 1103, ".1f"),
            Figure("bouc_wen_hardening_half", "1/m", 0, 2, ".1f"),
        ),
        measurements.bouc_wen,
        about_s=25,
        needs_recordings=True,
    ),
    Measurement(
        "peers",
        "python benchmarks/peers/compare.py --only torchpi,lstsq",
        (
            Figure("peers_joint_v", "V", 0.013, 0.014, ".4f"),
            Figure("peers_two_stage_v", "V", 0.05, 0.062, ".4f"),
            Figure("peers_lstsq_v", "V", 0.033, 0.035, ".4f"),
        ),
        measurements.peers,
        about_s=40,
    ),
    Measurement(
        "commission",
        README_COMMANDS + "its `torchpi commission` line",
        (
            Figure("commission_without_nm", "nm", 620, 680, ".0f"),
            Figure("commission_with_nm", "nm", 100, 210, ".0f"),
            Figure("commission_stage_nm", "nm", 3, 6, ".1f"),
            Figure("commission_true_nm", "nm", 100, 210, ".0f"),
            Figure("commission_heldout_um_s", "µm/s", 2900, 3200, ",.0f"),
            Figure("commission_trained_um_s", "µm/s", 2250, 2500, ",.0f"),
            Figure("commission_beyond_percent", "%", 0.3, 3, ".1f"),
            Figure("commission_s", "s", 15, 120, ".0f"),
        ),
        measurements.commissioning,
        about_s=60,
    ),
    Measurement(
        "demo",
        "python benchmarks/profile_demo.py, which runs the commands of `make demo`",
        (
            Figure("demo_without_max_percent", "%", 9, 13, ".0f"),
            Figure("demo_without_nm", "nm", 400, 440, ".0f"),
            Figure("demo_two_stage_nm", "nm", 20, 40, ".0f"),
            Figure("demo_nm", "nm", 5, 15, ".1f"),
            Figure("demo_s", "s", 10, 180, ".0f"),
            Figure("demo_training_percent_of_time", "%", 10, 50, ".0f"),
            Figure("demo_pages_percent_of_time", "%", 10, 50, ".0f"),
            Figure("demo_imports_percent_of_time", "%", 5, 40, ".0f"),
            Figure("demo_loop_percent_of_time", "%", 3, 30, ".0f"),
            Figure("demo_rest_percent_of_time", "%", 1, 30, ".0f"),
        ),
        measurements.demo,
        about_s=90,
    ),
    Measurement(
        "simulation",
        "python -m benchmarks.figures --only simulation",
        (
            Figure("simulation_calls", "1", 100, 10_000, ",.0f"),
            Figure("simulation_called_lag_hz", "Hz", 98, 102, ".1f"),
            Figure("simulation_called_creep_percent", "%", 1.95, 2.05, ".2f"),
            Figure("simulation_called_mode_hz", "Hz", 299, 301, ".1f"),
            Figure("simulation_called_replaced_hz", "Hz", 260, 280, ".0f"),
            Figure("simulation_called_given_nm", "nm", 170, 190, ".0f"),
            Figure("simulation_called_retuned_nm", "nm", 110, 125, ".0f"),
            Figure("simulation_called_augmented_nm", "nm", 3.5, 4.5, ".1f"),
            Figure("simulation_column_lag_hz", "Hz", 85, 115, ".0f"),
            Figure("simulation_column_given_nm", "nm", 170, 190, ".0f"),
            Figure("simulation_column_retuned_nm", "nm", 110, 125, ".0f"),
            Figure("simulation_column_augmented_nm", "nm", 3.5, 30, ".0f"),
        ),
        measurements.other_simulation,
        about_s=120,
    ),
    Measurement(
        "recipe",
        "python benchmarks/recipe.py",
        (
            Figure("recipe_cases", "1", 17, 17, ".0f"),
            Figure("recipe_median", "1", 0, 0.7, ".2f"),
            Figure("recipe_largest", "1", 0, 1, ".2f"),
        ),
        measurements.recipe_seed_1,
        about_s=120,
        needs_recordings=True,
    ),
    Measurement(
        "recipe_others",
        "python benchmarks/recipe.py --seeds 2 --only 'seed 2'",
        (
            Figure("recipe_other_cases", "1", 12, 12, ".0f"),
            Figure("recipe_other_worse", "1", 0, 0, ".0f"),
            Figure("recipe_other_largest", "1", 0, 1, ".2f"),
            Figure("recipe_other_second", "1", 0, 1, ".2f"),
        ),
        measurements.recipe_seed_2,
        about_s=90,
    ),
    Measurement(
        "recipe_single",
        "python benchmarks/recipe.py --first_seed 601 --seeds 8 --only 'one sine,two sines'",
        (
            Figure("recipe_single_cases", "1", 64, 64, ".0f"),
            Figure("recipe_single_worse", "1", 0, 0, ".0f"),
            Figure("recipe_single_median", "1", 0, 0.7, ".2f"),
            Figure("recipe_single_largest", "1", 0, 1, ".2f"),
        ),
        measurements.recipe_single,
        about_s=130,
    ),
)

FIGURES = {figure.name: figure for one in MEASUREMENTS for figure in one.figures}

MEASURED_PAGES = {
    "docs/peers.md": "python benchmarks/peers/compare.py --write",
    "docs/proof.md": "python -m concealed page",
}
"""Pages that a command writes entirely, with the date and the commit of the run in their text."""

DEFINITIONS = {
    # Computed memory traffic of a pass; time spans in configs/piezo_stack.yaml; its authors' own results.
    "benchmarks/README.md": frozenset(
        {"256 MB", "17.6 MB", "5.6 MB", "56 s", "70.5 s", "1 s", "15 s", "0.58 µm", "1 %"}
    ),
    # The built-in stage's mode; the time span on which configs/piezo_stack.yaml is evaluated.
    "README.md": frozenset({"620 Hz", "56 s", "70.5 s"}),
    # Rules of the forward stage; the noise of configs/stage/default.yaml.
    "docs/commission.md": frozenset({"15 %", "2 %", "3 nm"}),
    "docs/diagnosis.md": frozenset(
        {
            "1.5 times",
            "90 %",
            "50 %",
            "15 %",
            "40 ms",
            "95 %",
            "0.2 times",
            "72 %",
            "98 %",
        }  # rules of the decision
        | {"2 kHz", "2 ×", "2 s", "4 nm", "100 Hz", "2 %", "300 Hz", "270 Hz"}  # the recordings of an example
        | {"2,540 Hz", "0.2 µm", "3.4 µm"}  # bounds of tests/diagnosis/test_modal.py
    ),
    # Settings of configs/mirror.yaml, of the loops, and of benchmarks/mirror_folds.py.
    "docs/mirror.md": frozenset({"540 s", "0.3 V", "2260 Hz", "2350 Hz"}),
    # Level of the intervals.
    "docs/bouc_wen.md": frozenset({"95 %"}),
    # An example of an option; a rule of the checks.
    "docs/recordings.md": frozenset({"0.5 µm", "100 times"}),
    # Limits of the excitations; rest before each run.
    "docs/rigs.md": frozenset({"10 V", "0 V", "50 ms"}),
}
"""Numbers with units that are not measured, by page: settings, rules, examples. All others are figures."""
