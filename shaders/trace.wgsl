// Shadow rays against the asset's triangles. CPU twin: scene::tracer (ShadowRays::unoccluded).
//
// Nodes lie in depth-first order and each knows where its subtree ends, so that traversal needs no stack: a missed node
// jumps to `after`, any other goes on to the next (Smits, Efficiency Issues for Ray Tracing, 1998).
struct Node {
    low: vec3f,       // metres, world space
    after: u32,       // index of the node behind this one's subtree
    high: vec3f,
    primitives: u32,  // leaf: first blocker · 8 + count; inner node: 0
}

// A triangle's corners, in the order of the leaves.
struct Blocker {
    a: vec3f,         // metres, world space
    triangle: u32,
    b: vec3f,
    masked: u32,      // 1 where the material cuts out where alpha is low
    c: vec3f,
}

@group(0) @binding(7) var<storage, read> nodes: array<Node>;
@group(0) @binding(8) var<storage, read> blockers: array<Blocker>;

// A segment ends just before the light, so that a light on a surface is not hidden by it.
const SEGMENT_END = 0.9999;

fn blocks(blocker: Blocker, origin: vec3f, segment: vec3f) -> bool {
    let a = blocker.a - origin;
    let b = blocker.b - origin;
    let c = blocker.c - origin;
    // Signed volumes of the segment with each edge; triangles that share an edge compute the same one for it.
    let wa = dot(segment, cross(b, c));
    let wb = dot(segment, cross(c, a));
    let wc = dot(segment, cross(a, b));
    let inside = min(wa, min(wb, wc)) >= 0.0 || max(wa, max(wb, wc)) <= 0.0;
    let sum = wa + wb + wc;
    let volume = dot(a, cross(b - a, c - a));
    // 0 < volume / sum < SEGMENT_END without dividing.
    if !inside || volume * sum <= 0.0 || abs(volume) >= SEGMENT_END * abs(sum) {
        return false;
    }
    return blocker.masked == 0u || !is_cut_out(blocker.triangle, wb / sum, wc / sum);
}

// Whether anything lies on the open segment from `origin` along `segment`.
fn occluded(origin: vec3f, segment: vec3f) -> bool {
    // A finite inverse, so that 0 · ∞ never makes a NaN.
    let inverse = select(vec3f(1.0), vec3f(-1.0), segment < vec3f(0.0)) / max(abs(segment), vec3f(1e-20));
    let end = arrayLength(&nodes);
    var at = 0u;
    while at < end {
        let node = nodes[at];
        let p = (node.low - origin) * inverse;
        let q = (node.high - origin) * inverse;
        let entry = min(p, q);
        let leave = max(p, q);
        let near = max(max(entry.x, entry.y), max(entry.z, 0.0));
        let far = min(min(leave.x, leave.y), min(leave.z, 1.0));
        // Two roundings a side (Ize, Robust BVH Ray Traversal, 2013).
        if near > far * 1.0000003 {
            at = node.after;
            continue;
        }
        let first = node.primitives >> 3u;
        for (var i = first; i < first + (node.primitives & 7u); i++) {
            if blocks(blockers[i], origin, segment) {
                return true;
            }
        }
        at++;
    }
    return false;
}

// Whether what `arrival` brings to `origin`, just off a surface, gets there. CPU twin: LightGather::gather.
fn reaches(arrival: Arrival, origin: vec3f, geometric_normal: vec3f) -> bool {
    return any(arrival.irradiance > vec3f(0.0)) && dot(arrival.direction, geometric_normal) > 0.0
        && !occluded(origin, arrival.segment);
}
