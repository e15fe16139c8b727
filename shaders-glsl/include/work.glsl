// Work record with a count from the GPU: arguments of an indirect dispatch, and the number of elements.
struct Work {
    uint x;
    uint y;
    uint z;
    uint count;
};

// Workgroups for `count` elements of `per_group` each, folded past 65535 (one empty group when there is nothing).
Work work_for(uint count, uint per_group) {
    uint n = max(count / per_group + uint(count % per_group != 0u), 1u);
    uint x = min(n, 65535u);
    return Work(x, (n + x - 1u) / x, 1u, count);
}
