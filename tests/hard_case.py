"""The hard cases: what provokes each, what is promised, and the test that holds it.

Tests written for a case carry `@case`; others held theirs already and are listed in `ELSEWHERE`. Cases R are the
rasterizer's, cases V the rays', cases E the surroundings', cases A those of occlusion on the screen, cases I
invariances, of the rasterizer or of the whole picture.
`python -m tests.hard_case` writes their page.
"""

import ast
import functools
import pathlib
from collections.abc import Callable

ROOT = pathlib.Path(__file__).parents[1]
PAGE = ROOT / "docs" / "hard-cases.md"
HEAD = """# Hard cases

Inputs that break renderers, what is promised for each, and the test that holds it. R are the rasterizer's, V the
rays', E the surroundings', A those of occlusion on the screen, I invariances. Written by `python -m tests.hard_case`
from the tests themselves.

| id | input that provokes it | what is promised | test |
|---|---|---|---|
"""
NOT_BUILT = "not built yet"
RASTER, EXACT, CLIPPING, LIMITS = (
    f"tests/stages/{name}.py"
    for name in ("test_raster", "test_raster_exact", "test_raster_clipping", "test_raster_limits")
)
HARD, LIGHT, PLAN = "tests/gradients/test_hard_visibility.py", "tests/stages/test_light.py", "tests/laws/test_plan.py"
TRACE, INTERSECT, BVH = "tests/stages/test_trace.py", "tests/formulas/test_intersect.py", "tests/formulas/test_bvh.py"
PREFILTER, AROUND = "tests/stages/test_prefilter.py", "tests/stages/test_environment_light.py"
EQUIRECT, SUN, SURROUNDINGS = (
    f"tests/{name}.py" for name in ("formulas/test_equirect", "formulas/test_sun", "io/test_environment")
)
ONE_OWNER = "every sample has exactly one owner"
ELSEWHERE = [  # id, input, promise, test
    ("R1", "a quad whose diagonal passes through samples", ONE_OWNER, f"{RASTER}::test_drtk_quad_has_no_hole"),
    ("R2", "fans with their rim at up to 1e7 px", ONE_OWNER, f"{RASTER}::test_closed_fan_covers_every_pixel_once"),
    ("R2", "a fan with its rim at infinity", ONE_OWNER, f"{CLIPPING}::test_a_fan_to_infinity_covers_every_pixel_once"),
    (
        "R3",
        "the five fill-rule cases of conformance suites, at many angles",
        ONE_OWNER,
        f"{EXACT}::test_quad_covers_every_pixel_once",
    ),
    (
        "R4",
        "corners beside, behind and in the plane of the camera",
        "what lies before the near plane is drawn, and nothing else",
        f"{CLIPPING}::test_triangles_about_the_camera_equal_what_is_cut_beforehand",
    ),
    (
        "R5",
        "sheets through the near plane, at a thousand angles",
        "no crack and no pixel twice",
        f"{CLIPPING}::test_neighbours_cut_by_the_same_plane_leave_no_crack_at_a_thousand_angles",
    ),
    (
        "R5",
        "triangles in the near plane",
        "seen whole, at depth 1",
        f"{CLIPPING}::test_triangles_in_the_near_plane_are_seen_whole",
    ),
    (
        "R7",
        "a vertex that is NaN, infinite or too large",
        "its triangles are left out and counted; no other pixel changes",
        f"{RASTER}::test_broken_triangle_changes_nothing_and_is_counted",
    ),
    ("R7", "such a vertex of no face", "nothing changes", f"{RASTER}::test_unreferenced_broken_vertex_changes_nothing"),
    (
        "R7",
        "the gradients beside such a vertex",
        "finite, as they are without it",
        f"{HARD}::test_a_broken_triangle_leaks_into_no_gradient",
    ),
    (
        "R9",
        "triangles of equal depth, ten copies of each",
        "the lowest id is seen",
        f"{EXACT}::test_exact_ties_go_to_the_lowest_id",
    ),
    (
        "R10",
        "planes 4 ulp of depth apart, at distances from 1 to 900",
        "the nearer is seen on every pixel",
        f"{LIMITS}::test_planes_parallel_to_the_screen_four_ulp_apart_are_ordered",
    ),
    (
        "R14",
        "a million triangles in one pixel",
        "the nearest is seen: nothing overflows",
        f"{LIMITS}::test_a_million_triangles_in_one_pixel",
    ),
    (
        "R15",
        "no faces, no vertices, pictures of one pixel, row or column",
        "a picture of the background, or the triangle",
        f"{RASTER}::test_odd_sizes_and_empty_scenes",
    ),
    (
        "R17",
        "corners and edges on pixel centres and borders",
        "as integers decide it for every pixel of every box",
        f"{EXACT}::test_each_path_equals_the_integer_twin",
    ),
    (
        "R18",
        "triangles beyond the border, in one of several pictures",
        "each picture is as if drawn alone",
        f"{RASTER}::test_batches_equal_one_by_one",
    ),
    (
        "R20",
        "a vertex on a pixel's centre, with up to 1024 triangles",
        ONE_OWNER,
        f"{EXACT}::test_closed_fan_about_a_pixel_centre_covers_every_pixel_once",
    ),
    ("R21", "a triangle seen edge-on, where silhouettes are smoothed", "gradients are finite and bounded", NOT_BUILT),
    (
        "V1",
        "rays along the axes through every face, edge and corner of a grid, components 0 and -0",
        "each hits, at the exact distance",
        f"{TRACE}::test_axis_aligned_rays_hit_every_face_edge_and_corner_of_a_cube_grid",
    ),
    (
        "V2",
        "closed fans of 4 to 1024 triangles, at the origin and 1e4 away from it",
        "no ray slips through",
        f"{TRACE}::test_no_ray_slips_through_the_spokes_or_the_hub_of_a_closed_fan",
    ),
    (
        "V2",
        "a sphere about (148376, 1234, -223423), seen from inside",
        "no ray leaves",
        f"{TRACE}::test_no_ray_leaves_a_sphere_far_from_the_origin",
    ),
    (
        "V3",
        "rays at the corners of triangles of a bundle",
        "none is left out that a ray meets",
        f"{TRACE}::test_triangles_are_left_out_only_where_no_ray_meets_them",
    ),
    (
        "V4",
        "rays that leave a triangle, at scales from 1e-8 to 1e8",
        "none meets it again",
        f"{INTERSECT}::test_no_spawned_ray_meets_its_own_triangle",
    ),
    (
        "V5",
        "NaN, infinite and zero origins, directions and limits",
        "nothing hit, no step more, no other ray changed",
        f"{TRACE}::test_invalid_rays_hit_nothing_cost_nothing_and_change_nothing",
    ),
    (
        "V6",
        "trees of 1, 2 and 100,000 triangles in one place",
        "the lowest face, and an end",
        f"{TRACE}::test_trees_of_coincident_triangles_give_the_lowest_and_end",
    ),
    (
        "V6",
        "a chain of ever larger triangles",
        "a tree no deeper than the bound",
        f"{BVH}::test_a_chain_of_ever_larger_triangles_is_no_deeper_than_the_bound",
    ),
    (
        "V7",
        "triangles that are degenerate, not finite or of no vertex",
        "never hit, and counted",
        f"{INTERSECT}::test_what_can_never_be_hit_is_counted_and_zero",
    ),
    (
        "V8",
        "triangles of 1e6 and of 1e-3 in one scene",
        "the hits of double precision",
        f"{TRACE}::test_soups_of_very_large_and_very_small_triangles_are_hit_as_in_double_precision",
    ),
    (
        "V9",
        "triangles on a line, and seen edge-on",
        "no hit, finite gradients",
        f"{TRACE}::test_trees_of_collinear_triangles_hit_nothing",
    ),
    (
        "V10",
        "parts of a file that are mirrored, or flattened by a scale of 0",
        "normals, tangents and winding agree; flat ones keep unit normals",
        "tests/io/test_gltf.py::test_normals_tangents_and_winding_agree_under_any_transform",
    ),
    (
        "V11",
        "t_max and t_min at the hit itself, and a rounding beside it",
        "occluded where there is a closest hit",
        f"{TRACE}::test_any_hit_is_closest_hit_within_the_same_limits",
    ),
    (
        "V12",
        "a stack without room, and rays that meet every box",
        "nothing is lost",
        f"{TRACE}::test_a_stack_without_room_loses_nothing",
    ),
    (
        "E1",
        "directions at the poles and within 1e-6 of them, of no length, not finite",
        "finite values and gradients",
        f"{EQUIRECT}::test_lookup_is_finite_at_poles_and_seam_and_where_there_is_no_direction",
    ),
    (
        "E2",
        "directions across the seam of a picture",
        "no step there; what is constant stays so",
        f"{EQUIRECT}::test_there_is_no_step_at_the_seam_nor_over_a_pole",
    ),
    (
        "E2",
        "surroundings turned by whole columns",
        "the picture rolled by as many",
        f"{EQUIRECT}::test_turning_by_whole_columns_rolls_the_picture",
    ),
    (
        "E3",
        "texels that are NaN, infinite or negative",
        "put right when read, and counted",
        f"{SURROUNDINGS}::test_what_was_put_right_is_said_every_time",
    ),
    (
        "E3",
        "a sun of one texel or of many, at a pole, across the seam",
        "cut out to be a light of its own; no light lost",
        f"{SUN}::test_a_sun_is_cut_and_no_light_is_lost",
    ),
    (
        "E4",
        "pictures that are black, constant, of one texel or one column",
        "no sun in them, nothing that is not finite",
        f"{SUN}::test_there_is_no_sun_where_there_is_none",
    ),
    (
        "E4",
        "pictures that are not twice as wide as high",
        "refused in one line, but for a single pixel",
        f"{SURROUNDINGS}::test_what_is_no_picture_of_all_directions_is_refused",
    ),
    ("E5", "directions drawn from a picture with black rows", "none from a black texel", NOT_BUILT),
    (
        "E6",
        "roughness 0, 1 and beyond, pictures of one texel",
        "the ends' levels, without a step",
        f"{PREFILTER}::test_roughness_beyond_both_ends_is_that_of_the_ends",
    ),
    (
        "E7",
        "constant surroundings",
        "the constant at every level",
        f"{PREFILTER}::test_a_constant_is_exact_at_every_level",
    ),
    (
        "E7",
        "white metal and plastic, coated or not, in uniform surroundings",
        "not to be told from them",
        f"{AROUND}::test_what_is_white_cannot_be_told_from_uniform_surroundings",
    ),
    (
        "E8",
        "mirrors and the roughest, seen edge-on, at poles and seams, black and at 6e4",
        "finite values and gradients",
        f"{AROUND}::test_values_and_gradients_are_finite_everywhere",
    ),
    (
        "E9",
        "directions with equal components, on edges and corners of the octahedron",
        "no seam",
        "tests/formulas/test_octahedral.py::test_there_is_no_seam",
    ),
    (
        "E10",
        "light from one direction in nine harmonics",
        "no negative irradiance",
        f"{AROUND}::test_a_map_of_irradiance_follows_what_harmonics_leave_out",
    ),
    (
        "I1",
        "a picture drawn inside and outside of `jit`",
        "the same faces, floats to rounding",
        f"{PLAN}::test_jit_sees_the_same_triangles",
    ),
    (
        "I2",
        "faces and vertices in another order",
        "the same bits, under the new ids",
        f"{EXACT}::test_order_of_faces_vertices_and_corners_changes_no_bit",
    ),
    (
        "I3",
        "corners of a face named in another order",
        "the same faces, weights in that order",
        f"{EXACT}::test_order_of_faces_vertices_and_corners_changes_no_bit",
    ),
    (
        "I4",
        "clip positions scaled by 2^±40",
        "the same bits",
        f"{RASTER}::test_scaling_by_powers_of_two_changes_no_bit",
    ),
    ("I7", "a batch", "its pictures one by one", f"{RASTER}::test_batches_equal_one_by_one"),
    ("I7", "one picture drawn by several devices", "the same bits", NOT_BUILT),
    ("I9", "every triangle ten times", "the same faces", f"{EXACT}::test_exact_ties_go_to_the_lowest_id"),
    (
        "I11",
        "many lights",
        "the sum of each alone, within 4 ulp",
        f"{LIGHT}::test_many_lights_are_the_sum_of_each",
    ),
    ("I12", "a closed white world, by reflections on the screen and by paths", "1 everywhere", NOT_BUILT),
]


def case(id: str, provoked: str, promise: str) -> Callable[[Callable], Callable]:
    """Says which hard case a test holds, in literals, for they are read from the source."""
    assert id and provoked and promise
    return lambda test: test


def decorated() -> list[tuple[str, str, str, str]]:
    """What the tests in `tests/hard_cases` say of themselves: id, input, promise, test."""
    rows = []
    for path in sorted((ROOT / "tests" / "hard_cases").glob("test_*.py")):
        for node in ast.parse(path.read_text()).body:
            for mark in getattr(node, "decorator_list", []):
                if isinstance(mark, ast.Call) and ast.unparse(mark.func) == "case":
                    words = (ast.literal_eval(word) for word in mark.args)
                    rows.append((*words, f"{path.relative_to(ROOT)}::{node.name}"))
    return rows


@functools.cache
def _functions(file: str) -> set[str]:
    """Names of the functions of a file, none where there is no such file."""
    path = ROOT / file
    body = ast.parse(path.read_text()).body if path.exists() else []
    return {node.name for node in body if isinstance(node, ast.FunctionDef)}


def missing(tests: list[str]) -> list[str]:
    """Which of the tests, `file::function`, do not exist."""
    return [test for test in tests if test.split("::")[1] not in _functions(test.split("::")[0])]


def rows() -> list[tuple[str, str, str, str]]:
    """All cases, by id."""
    return sorted(ELSEWHERE + decorated(), key=lambda row: ("RVEAI".index(row[0][0]), int(row[0][1:])))


def page() -> str:
    """docs/hard-cases.md."""
    lines = []
    for id, provoked, promise, test in rows():
        lines.append(f"| {id} | {provoked} | {promise} | {test if test == NOT_BUILT else f'`{test}`'} |\n")
    return HEAD + "".join(lines)


if __name__ == "__main__":
    PAGE.write_text(page())
