import pytest
from map_scenarios import hall

from crowdbench.scenario import ScenarioError
from crowdbench.scenario.streams import stream_sizes

WEST_EAST = {"start": "west", "goal": "east"}


@pytest.mark.parametrize(
    ("streams", "message"),
    [
        ([{"start": "west"}], "streams.0.goal: missing"),
        ([WEST_EAST, {**WEST_EAST, "goal": "eest"}], "streams.1.goal: unknown region 'eest'"),
        ([{**WEST_EAST, "start": "wst"}], "streams.0.start: unknown region 'wst'; did you mean"),
        ([{**WEST_EAST, "via": ["door"]}], "streams.0.via: unknown region 'door'; known: west, ea"),
        ([{**WEST_EAST, "goal": "west"}], "streams.0.goal: 'west' is the start too; allowed: ano"),
        ([{**WEST_EAST, "share": 0.6}] * 2, "streams: the shares add up to 1.2; allowed: 1 at mo"),
        ([{**WEST_EAST, "share": 1.5}], "streams.0.share: 1.5 is out of range; allowed: >= 0"),
        ([{**WEST_EAST, "shares": 1}], "unknown key 'pedestrians.streams.0.shares'; did you mean"),
        ([{**WEST_EAST, "via": "east"}], "streams.0.via: expected a list of regions (got 'east')"),
        ([{**WEST_EAST, "via": ["east"] * 9}], "streams.0.via: 9 are too many; allowed: 6 at mo"),
        ([WEST_EAST] * 40, "streams: 40 are too many; allowed: 32 at most"),
        (["west"], "streams: expected a list of streams {start: region, goal: region, share: 0.5}"),
    ],
)
def test_streams_that_say_no_route_are_refused(streams, message):
    with pytest.raises(ScenarioError) as caught:
        hall(pedestrians__streams=streams)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("shares", "sizes"),
    [([0.5, 0.5], [4, 4]), ([0.3, 0.3, 0.3], [2, 3, 2]), ([1.0], [8]), ([0.0, 0.1], [0, 1])],
)
def test_shares_become_whole_people(shares, sizes):
    streams = [{**WEST_EAST, "share": share} for share in shares]
    scenario = hall(pedestrians__streams=streams, pedestrians__count=8)
    assert stream_sizes(scenario.pedestrians) == sizes


def test_streams_take_no_more_people_than_queues_leave():
    """Of eight people a queue of three takes four."""
    queueing = {"pedestrians__count": 8, "pedestrians__queues": [{"head": [0, 0], "count": 3}]}
    fitting = hall(**queueing, pedestrians__streams=[{**WEST_EAST, "share": 0.5}])
    assert stream_sizes(fitting.pedestrians) == [4]
    with pytest.raises(ScenarioError, match=r"shares take 5 of .* queues leave 4; allowed: 0\.5 "):
        hall(**queueing, pedestrians__streams=[{**WEST_EAST, "share": 0.6}])


@pytest.mark.parametrize(("share", "standing", "allowed"), [(0.5, 0.8, "0.5"), (1.0, 0.1, "0")])
def test_those_who_stand_are_no_more_than_streams_leave(share, standing, allowed):
    people = {"count": 10, "streams": [{**WEST_EAST, "share": share}]}
    hall(pedestrians=people | {"standing": 1 - share})
    with pytest.raises(ScenarioError) as caught:
        hall(pedestrians=people | {"standing": standing})
    left = 10 - round(10 * share)
    assert str(caught.value).endswith(
        f"pedestrians.standing: {round(10 * standing)} of pedestrians.count 10 people, but queues "
        f"and streams leave {left}; allowed: <= {allowed}"
    )
