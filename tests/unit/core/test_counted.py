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


def test_messages_that_were_lost_are_not_waited_for_for_ever():
    """A reader stood still until its queue ran over: then it is as far as the others again."""
    counted = CountedInput()
    for k in range(100):
        if not 20 <= k < 60:
            counted.received(10 * k)
        counted.announced(k + 1, 10 * k)
        assert counted.counting == (k < 60)
    assert counted.valid_through == 990


def test_a_watermark_that_overtakes_its_messages_waits_for_them_however_late():
    counted = CountedInput()
    for k in range(50):
        counted.announced(k + 1, 10 * k)
    for k in range(50):
        assert counted.valid_through == (10 * (k - 1) if k else -1)
        counted.received(10 * k)
    assert counted.counting
    # Messages ahead of their watermarks say nothing of others.
    for k in range(50, 60):
        counted.received(10 * k)
    counted.announced(60, 590)
    assert counted.counting
    assert counted.valid_through == 590


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
