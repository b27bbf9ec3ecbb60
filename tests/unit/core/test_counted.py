from deepseis_core.counted import CountedInput


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
