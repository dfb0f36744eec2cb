from calibration.robot.simulation.kinematics import stream


def test_each_purpose_has_its_own_numbers() -> None:
    draws = [
        stream(*purpose).standard_normal(3).tolist()
        for purpose in ((1, 0, "a"), (1, 0, "b"), (1, 1, "a"), (2, 0, "a"), (1, "a", 0), (1,), (1, 0))
    ]
    assert len({tuple(draw) for draw in draws}) == len(draws)
    assert draws[0] == stream(1, 0, "a").standard_normal(3).tolist()


def test_the_numbers_are_these_on_every_machine() -> None:
    assert stream(1, 0, "left_camera").integers(0, 1000, 4).tolist() == [992, 454, 793, 183]
