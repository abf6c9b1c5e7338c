from placement.verdict import Verdict


def test_every_verdict_has_words():
    assert len({v.phrase for v in Verdict}) == len(Verdict)
