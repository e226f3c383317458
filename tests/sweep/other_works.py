"""Work of test workers instead of driving: answer at once, or die."""

import os
import signal

from gsrain_engine.sweep.worker import JobResult


def answer(job):
    return JobResult(id=job.id, values={"end": job.scene})


def die_of_one(job):
    if job.seed == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return answer(job)
