from hulldown.plan.rejection import CAMERA_REJECTIONS, PLACE_REJECTIONS, Rejection


def test_every_rejection_has_different_words_and_is_one_of_places_or_of_cameras():
    assert len({r.phrase for r in Rejection}) == len(Rejection)
    assert {*PLACE_REJECTIONS, *CAMERA_REJECTIONS} == set(Rejection) - {Rejection.NONE}


def test_codes_and_keys_of_plan_files_never_change():
    assert [r.key for r in Rejection] == [
        "none", "off_ground", "too_steep", "overhang", "mean_too_steep", "gap", "penetration", "obstacle", "vehicle",
        "companion", "no_view", "distance", "camera_off_ground", "camera_low", "camera_obstacle", "camera_vehicle",
        "truncation", "small", "hidden", "exposed", "size", "water", "dark", "camera_water", "faint",
    ]  # fmt: skip
    assert [int(r) for r in Rejection] == list(range(len(Rejection)))
