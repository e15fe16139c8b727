// How many elements there are: `push.limit`, or fewer if a Work record says so. Needs `push.limit`.
layout(constant_id = 15) const bool GPU_COUNT = false;

// Bound to anything, and not read, when the host knows the count.
IN(Work, work);

uint element_count() { return GPU_COUNT ? min(work[0].count, push.limit) : push.limit; }
