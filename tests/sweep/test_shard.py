import pytest

from gsrain_engine.sweep.expansion import Shard

from .small_sweep import small_jobs


def test_shares_are_all_jobs_each_once_and_about_as_many(tmp_path):
    jobs = small_jobs(tmp_path, seeds=5)
    shares = [Shard.parse(f"{each}/3").of(jobs) for each in (1, 2, 3)]
    assert sorted(job.id for share in shares for job in share) == sorted(job.id for job in jobs)
    assert [len(share) for share in shares] == [4, 3, 3]
    assert Shard.parse("2/3").of(jobs[::-1]) == shares[1][::-1]


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "1/0", "-1/3", "1/3/5", "$X/2"])
def test_what_is_no_share_is_refused(text):
    with pytest.raises(ValueError, match=f"shard {text.replace('$', '.')}: "):
        Shard.parse(text)
