// Reads one buffer and writes another: what the adapter's memory can do. One invocation a vector.
@group(0) @binding(0) var<storage, read> source: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> destination: array<vec4f>;

@compute @workgroup_size(256)
fn copy(@builtin(workgroup_id) workgroup: vec3u, @builtin(num_workgroups) all: vec3u, @builtin(local_invocation_index) lane: u32) {
    let at = (workgroup.y * all.x + workgroup.x) * 256u + lane;
    if at < arrayLength(&source) {
        destination[at] = source[at];
    }
}
