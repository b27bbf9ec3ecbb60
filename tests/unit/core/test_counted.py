from deepseis_core.counted import CountedInput, CountedTopics


def test_a_watermark_holds_once_its_messages_are_there():
    counted = CountedInput()
    counted.announced(2, 100)
    assert counted.valid_through == -1
    counted.received()
    counted.announced(2, 200)
    assert counted.valid_through == -1
    counted.received()
    assert counted.valid_through == 200


def test_a_publisher_started_again_is_believed_at_once():
    counted = CountedInput()
    for _ in range(5):
        counted.received()
    counted.announced(7, 100)  # two were lost when it died
    counted.announced(0, -1)
    counted.announced(3, 300)
    assert counted.valid_through == 300


def test_a_reader_that_joins_does_not_wait_for_what_it_missed():
    counted = CountedInput(counting=False)
    counted.announced(12_000, 300)
    assert counted.valid_through == 300


def test_topics_hold_together_and_of_others_nothing_is_kept():
    """Counts of a topic that is not read would wait for its messages for ever."""
    topics = CountedTopics(["positions", "precise"])
    for k in range(100):
        topics.announced({"positions": k // 5 + 1, "precise": k + 1, "rtk": k + 1}, 10 * k)
        if k % 5 == 0:
            topics.received("positions")
        assert topics.valid_through == (10 * (k - 1) if k else -1)
        topics.received("precise")
        assert topics.valid_through == 10 * k
    assert not any(item._announced for item in topics._inputs.values())
