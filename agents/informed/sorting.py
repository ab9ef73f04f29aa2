"""Sorting partial plans by their scores.

This is the quicksort of numba's ``argsort``, step by step: how it orders equal scores decides
plans, and compiling its general form takes a second and a half.
"""

from __future__ import annotations

import numpy as np

from crowdbench.compiled import compiled

SMALL = 15
"""Parts of a list smaller than this are sorted by insertion."""


@compiled()
def sort(score, order):
    """Write the order of the first scores, the lowest first.

    Args:
        score: (M,) none of them NaN.
        order: (N,) with N <= M, of int64, written: the first N scores are sorted.
    """
    for i in range(len(order)):
        order[i] = i
    parts = np.empty((64, 2), dtype=np.int64)
    parts[0, 0], parts[0, 1] = 0, len(order) - 1
    waiting = 1
    while waiting > 0:
        waiting -= 1
        low, high = parts[waiting, 0], parts[waiting, 1]
        while high - low >= SMALL:
            middle = (low + high) >> 1
            for a, b in ((low, middle), (middle, high), (low, middle)):
                if score[order[b]] < score[order[a]]:
                    order[a], order[b] = order[b], order[a]
            pivot = score[order[middle]]
            order[high], order[middle] = order[middle], order[high]
            i, j = low, high - 1
            while True:
                while i < high and score[order[i]] < pivot:
                    i += 1
                while j >= low and pivot < score[order[j]]:
                    j -= 1
                if i >= j:
                    break
                order[i], order[j] = order[j], order[i]
                i, j = i + 1, j - 1
            order[i], order[high] = order[high], order[i]
            # The larger part waits, so that never more than log2 of all are waiting.
            if high - i > i - low:
                parts[waiting, 0], parts[waiting, 1], high = i + 1, high, i - 1
            else:
                parts[waiting, 0], parts[waiting, 1], low = low, i - 1, i + 1
            waiting += 1
        for i in range(low + 1, high + 1):
            moved, j = order[i], i
            while j > low and score[moved] < score[order[j - 1]]:
                order[j] = order[j - 1]
                j -= 1
            order[j] = moved
