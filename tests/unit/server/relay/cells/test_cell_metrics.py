"""The numbers of all cells, as a Prometheus that reaches one of them asks for them."""

from relay_server import until


async def test_what_a_cell_does_not_have_is_said_to_be_missing(cell_a, cell_b, http):
    async def answer_of(cell):
        url = f"{cell_a.server.inside_url}/metrics"
        async with http.get(url, params={"cell": cell}) as answer:
            return answer.status, (await answer.json())["detail"]

    await until(lambda: cell_a.relay.peers.find("b"), "cell b is connected")
    assert await answer_of("c") == (404, "cannot read the metrics of cell c: it is not connected")
    with cell_b.listener.frozen():
        status, detail = await answer_of("b")
    assert (status, detail) in {
        (503, "cannot read the metrics of cell b: no answer in time"),
        (404, "cannot read the metrics of cell b: it is not connected"),
    }
