"""Index of the paper's equations: number, what it says, function, test, what is wrong with it as printed."""

from __future__ import annotations

from typing import NamedTuple


class Equation(NamedTuple):
    """One row; functions and tests are names that exist, without ``cdm_pin.`` and ``tests/``."""

    number: str
    says: str
    function: str
    test: str
    misprint: str = ""


_FREE = "test_cables.test_route_1_equals_route_2"
_PRINTED = "test_cables.test_route_3_equals_route_1_for_two_links"

EQUATIONS = [
    Equation(
        "1",
        "where the cable touches joint and link guide pulley",
        "geometry.tangent_residual",
        "test_geometry.test_physical_root_satisfies_eq_1_and_is_the_inner_tangent",
        "two roots; `wrap_half_angle` gives the cable's in closed form",
    ),
    Equation("2", "theta_g0 is the complement of theta_j0", "geometry.wrap_half_angle", "test_geometry.test_table_1"),
    Equation("3", "rotation between link frames", "kernels.rnea", "test_dynamics.test_against_pinocchio"),
    Equation("4", "its inverse is its transpose", "kernels.rnea", "test_dynamics.test_against_pinocchio"),
    Equation(
        "5",
        "joint angle from the links' x axes",
        "model.CableModel.configuration",
        "test_dynamics.test_against_pinocchio",
        "arcsin is ambiguous past 90 deg; the joint angle itself is used",
    ),
    Equation("6", "joint angles from motor angles", "transmission.joint_from_motor", "test_transmission.test_eq_6"),
    Equation("7", "angular velocity, base to tip", "recursion.link_wrenches", _FREE, "joint index one off"),
    Equation(
        "8", "angular acceleration", "recursion.link_wrenches", _FREE, "joint index one off, and not the same twice"
    ),
    Equation("9", "acceleration of the joint's origin", "recursion.link_wrenches", _FREE),
    Equation("10", "acceleration of the centre of mass", "recursion.link_wrenches", _FREE),
    Equation("11", "force of inertia", "recursion.link_wrenches", _FREE),
    Equation("12", "moment of inertia forces", "recursion.link_wrenches", _FREE),
    Equation("13", "force balance of a link", "recursion.newton_euler", _FREE, "adds cable forces; subtract them"),
    Equation("14", "moment balance about the centre of mass", "recursion.newton_euler", _FREE),
    Equation("15", "moment of the driving cable", "recursion.newton_euler", _FREE, "adds cable moments; subtract"),
    Equation(
        "16",
        "motor torque from the cable's moment",
        "dynamics.inverse_dynamics",
        "test_transmission.test_virtual_work",
        "with n_i, not the joint torque: tau_m = E' tau",
    ),
    Equation("17", "cable moment from tensions", "cables.cable_state", "test_cables.test_tensions_drive_the_link"),
    Equation(
        "18",
        "resultant on a pulley",
        "cables.cable_forces",
        "test_cables.test_a_guide_pulley_carries_twice_the_tension_times_the_half_sine",
        "holds for parallel strands only",
    ),
    Equation("19", "angle of contact", "cables.contact_geometry", "test_cables.test_contacts_of_the_papers_arm"),
    Equation("20", "forces of the link guide pulleys", "cables.cable_forces", _FREE),
    Equation(
        "21",
        "force of the joint guide pulley",
        "cables.cable_forces",
        "test_cables.test_newtons_third_law",
        "cos + 1 and cos - 1 belong swapped, second row's sign turned",
    ),
    Equation("22", "hinge force against the lower side", "cables.hinge_reaction", _FREE),
    Equation("23", "hinge force against the upper side", "cables.hinge_reaction", _FREE),
    Equation("24", "all cable forces on a link", "cables.cable_forces", _FREE, "f_5 does not belong to j = i + 1"),
    Equation("25", "moment of the guide pulleys' forces", "recursion.newton_euler", _FREE),
    *(
        Equation(str(n), f"place of point {name}", "routing.link_points", "test_geometry.test_points_of_a_link")
        for n, name in zip(range(26, 32), "ABCDVU", strict=True)
    ),
    Equation("32", "they cancel for the next link's cable", "recursion.newton_euler", _FREE),
    Equation(
        "33", "moment of cables that pass on", "recursion.newton_euler", _FREE, "joint guide pulley's force missing"
    ),
    Equation("34", "(15) with (32)", "printed.printed_cable_torque", _PRINTED, "no cable term should be left"),
    *(
        Equation(
            str(n),
            "pretension drives nothing" + where,
            "recursion.newton_euler",
            "test_cables.test_pretension_loads_bearings_and_never_motors",
        )
        for n, where in ((35, ", last link"), (36, ", the one before"), (37, ""))
    ),
    Equation("38", "tension without pretension", "cables.cable_state", "test_cables.test_tensions_drive_the_link"),
    Equation("39", "(20) with it", "cables.cable_forces", _FREE),
    Equation(
        "40",
        "(24) with it",
        "printed.printed_cable_torque",
        _PRINTED,
        "inherits (21); wrong for three links: test_route_3_is_wrong_for_three_links",
    ),
    Equation("41", "(33) with it", "printed.printed_cable_torque", _PRINTED, "n_j is meant, not n_i"),
    Equation(
        "42",
        "M, C, G of the motors",
        "dynamics.mass_matrix",
        "test_dynamics.test_the_equation_of_motion_adds_up",
    ),
    Equation(
        "43",
        "torque is linear in parameters",
        "regressor.motor_regressor",
        "test_regressor.test_the_regressor_times_the_parameters_is_the_motor_torque",
    ),
    Equation(
        "44",
        "estimate by pseudo-inverse, motor by motor",
        "paper.per_joint_estimate",
        "test_paper.test_per_joint_and_shared_estimates_are_exact_without_noise_eq_44",
        "one parameter in two motors is estimated twice; `identify.identify` shares it",
    ),
    Equation(
        "45",
        "Fourier series",
        "fourier.FourierSeries",
        "test_excitation.test_velocity_and_acceleration_are_derivatives",
    ),
    Equation(
        "46",
        "limits of position, velocity, acceleration",
        "limits.usage",
        "test_excitation.test_limits_of_table_2_hold_on_a_fine_grid_and_are_touched",
        "printed r for d in the second derivative",
    ),
    Equation(
        "47",
        "starts at zero",
        "fourier.FourierSeries.closed",
        "test_excitation.test_closed_series_starts_at_zero_eq_47",
        "at zero but moving; `excitation.at_rest` adds a run-in",
    ),
    Equation(
        "48",
        "bounds of frequency and coefficients",
        "search_space.SearchSpace.box",
        "test_optimisers.test_candidates_stay_in_the_box",
        "Table 2's 1 rad is 20 times what its other limits allow",
    ),
    Equation(
        "49",
        "bounds of the sums of coefficients",
        "search_space.SearchSpace.penalised",
        "test_excitation.test_penalty_as_printed_meets_no_candidate_within_tight_limits",
        "never active within the limits",
    ),
    *(
        Equation(
            str(n),
            f"torque of cable {i} in symbols",
            "dynamics.inverse_dynamics",
            "test_dynamics.test_matrices_of_the_papers_arm",
        )
        for n, i in ((50, 1), (51, 2))
    ),
    Equation(
        "52",
        "refit of the actual motion",
        "fourier.fit_series",
        "test_excitation.test_refit_recovers_coefficients_and_frequency_from_a_wrong_guess_eq_52",
        "the loop adds harmonics that it leaves out",
    ),
    *(
        Equation(
            str(n), f"torque of motor {i} in numbers", "dynamics.inverse_dynamics", "test_dynamics.test_eqs_53_and_54"
        )
        for n, i in ((53, 1), (54, 2))
    ),
    *(
        Equation(
            str(n),
            f"motor {i}: coefficients times parameters",
            "paper.coefficient_matrices",
            "test_paper.test_coefficient_matrices_times_parameters_are_the_motor_torques_eqs_53_to_56",
        )
        for n, i in ((55, 1), (56, 2))
    ),
    *(
        Equation(
            str(n),
            f"parameters of motor {i}",
            "paper.NOMINAL",
            "test_paper.test_nominal_parameters_follow_from_table_1_eqs_57_58",
            "P_21 = P_22 are one parameter",
        )
        for n, i in ((57, 1), (58, 2))
    ),
    *(
        Equation(
            str(n),
            f"coefficient matrix of motor {i}",
            "paper.coefficient_matrices",
            "test_paper.test_condition_numbers_of_the_printed_trajectory",
        )
        for n, i in ((59, 1), (60, 2))
    ),
    *(
        Equation(
            str(n),
            f"printed optimum, joint {i}",
            "paper.DESIRED",
            "test_paper.test_printed_trajectory_breaks_its_acceleration_limit",
            misprint,
        )
        for n, i, misprint in ((61, 1, ""), (62, 2, "breaks Table 2's acceleration limit 2.28 times"))
    ),
    *(
        Equation(
            str(n),
            f"printed refit, joint {i}",
            "paper.ACTUAL",
            "test_paper.test_identification_in_closed_loop",
            "written with the symbol of the desired motion",
        )
        for n, i in ((63, 1), (64, 2))
    ),
    *(
        Equation(
            str(n),
            f"printed estimates, motor {i}",
            "paper.PRINTED_ESTIMATE",
            "test_paper.test_printed_estimates_miss_the_coupling_by_2_75_and_2_39_percent_eqs_65_to_68",
            f"P_2{i} is {error} % off",
        )
        for n, i, error in ((65, 1, 2.75), (66, 2, 2.39))
    ),
    *(
        Equation(
            str(n),
            f"true values, motor {i}",
            "paper.NOMINAL",
            "test_paper.test_nominal_parameters_follow_from_table_1_eqs_57_58",
        )
        for n, i in ((67, 1), (68, 2))
    ),
]
