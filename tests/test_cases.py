"""Which test covers which file of the shared cases; the folder's EXPECTED.md says what each should lead to."""

import importlib

COVERED = {
    "F01_nan_row.xyz": "tests.data.test_files:test_f01_nan_row_is_dropped_and_counted",
    "F03_comma_separated.xyz": "tests.data.test_files:test_f_cases_hold_the_same_12_points",
    "F05_plain_for_locale_test.xyz": "tests.data.test_files:test_f05_does_not_depend_on_the_locale",
    "F06_crlf_ascii.ply": "tests.data.test_files:test_f_cases_hold_the_same_12_points",
    "F08_points_only.ply": "tests.data.test_files:test_f_cases_hold_the_same_12_points",
    "F10_binary_mixed_fields.pcd": "tests.data.test_files:test_f_cases_hold_the_same_12_points",
    "F13_zero_points.pcd": "tests.test_reconstruct:test_cases_that_are_refused",
    "F15_one_point.xyz": "tests.test_reconstruct:test_cases_that_are_refused",
    "F17_millimetres_offset.xyz": "tests.test_reconstruction:test_f17_comes_back_in_millimetres",
    "F19_xyzrgb_header.txt": "tests.data.test_files:test_f_cases_hold_the_same_12_points",
    "F22_transposed_3xN.npy": "tests.test_reconstruct:test_cases_that_are_refused",
    "F25_no_final_newline.ply": "tests.data.test_files:test_f_cases_hold_the_same_12_points",
    "O01_upper_boundary.npy": "tests.ops.test_conventions:test_upper_boundary_belongs_to_the_last_cell",
    "O03_nan_inf_points.npy": "tests.ops.test_conventions:test_points_that_are_not_finite_leave_the_others_alone",
    "O05_axis_order.npz": "tests.ops.test_conventions:test_one_feature_at_a_corner_is_read_back_there",
    "I01_plateau_at_level_0.5.npy": "tests.ops.test_marching_cubes:test_i01_plateau_at_the_level",
    "I03_all_outside.npy": "tests.ops.test_marching_cubes:test_i03_no_surface_says_the_range",
    "I05_solid_touches_boundary.npy": "tests.ops.test_marching_cubes:test_i05_solid_at_the_border",
    "I07_one_nan_inside_level_0.npy": "tests.ops.test_marching_cubes:test_i07_values_that_are_not_finite_are_counted",
    "I11_values_equal_level_0.npy": "tests.ops.test_marching_cubes:test_i11_scattered_values_at_the_level",
    "G01_duplicate_touch.xyz": "tests.data.test_gp:test_duplicate_touch_is_absorbed",
    "G03_dense_slide_400.xyz": "tests.data.test_gp:test_dense_slide_fits_with_reported_jitter",
    "D01_open_box.obj": "tests.data.test_watertight:test_D01_open_box_is_counted_and_closed",
    "D03_inverted_winding.obj": "tests.data.test_watertight:test_D03_inverted_winding_is_flipped_with_a_warning",
    "D06_thin_plate.obj": "tests.data.test_occupancy:test_D06_thin_plate_gives_exactly_what_was_asked_for",
}


def test_every_case_has_its_test(shared_data):
    cases = {path.name for path in (shared_data / "cases").iterdir() if path.suffix != ".md"}
    assert cases == set(COVERED)


def test_the_tests_named_exist():
    for case, where in COVERED.items():
        module, name = where.split(":")
        assert callable(getattr(importlib.import_module(module), name, None)), f"{case}: {where}"
