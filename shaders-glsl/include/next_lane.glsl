// Walks the lanes of a ballot in their order. Needs SUBGROUP, which leaves out the words that no lane votes in.

// Whether a lane is left.
bool any_lane(uvec4 votes) {
    uint all_votes = votes.x;
    if (SUBGROUP > 32u) all_votes |= votes.y;
    if (SUBGROUP > 64u) all_votes |= votes.z | votes.w;
    return all_votes != 0u;
}

// The next lane of a ballot, which must have one; it leaves the ballot.
uint next_lane(inout uvec4 votes) {
    uint i = subgroupBallotFindLSB(votes);
    if (SUBGROUP <= 32u || i < 32u) votes.x &= votes.x - 1u;
    else if (SUBGROUP <= 64u || i < 64u) votes.y &= votes.y - 1u;
    else if (i < 96u) votes.z &= votes.z - 1u;
    else votes.w &= votes.w - 1u;
    return i;
}
