import subprocess
import sys

import pytest

FAULTS_OF_THE_LAST_ROUND = """
import resource, sys
import numpy as np
if sys.argv[1] == "kept":
    from gsrain_engine.malloc_tuning import tune_malloc
    tune_malloc()
for _ in range(4):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    arrays = [np.ones(1 << 20, np.float32) for _ in range(10)]
    del arrays
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def faults(mode: str) -> int:
    command = [sys.executable, "-c", FAULTS_OF_THE_LAST_ROUND, mode]
    return int(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="only glibc is told")
def test_memory_is_not_fetched_again_for_the_next_frame():
    assert faults("kept") < 100 < faults("returned")
