#version 330
// Positions of all strands lie in one texture, row after row. One instance is one strand, drawn as a triangle strip of
// two vertices per sample: this shader smooths the strand and gives it its width.
uniform sampler2D points;
uniform int strand_vertices;
uniform int samples;
uniform float strand_width;
uniform float sample_angle;
uniform vec3 eye;
uniform mat4 clip_from_world;
out vec3 world;
out vec3 tangent;
out float along;
out float across;
out float variation;
invariant gl_Position;  // the depth pass and the colour pass must agree to the last bit

vec3 point(int i) {
    i = clamp(i, 0, strand_vertices - 1) + gl_InstanceID * strand_vertices;
    int width = textureSize(points, 0).x;
    return texelFetch(points, ivec2(i % width, i / width), 0).xyz;
}

void main() {
    int part = gl_VertexID / 2;
    across = float(gl_VertexID % 2) * 2.0 - 1.0;
    along = float(part) / float(samples - 1);
    float s = along * float(strand_vertices - 1);
    int i = min(int(s), strand_vertices - 2);
    float u = s - float(i);
    vec3 b = point(i), c = point(i + 1);
    vec3 a = i > 0 ? point(i - 1) : 2.0 * b - c;
    vec3 d = i < strand_vertices - 2 ? point(i + 2) : 2.0 * c - b;
    // Catmull-Rom: through every vertex of the strand, tangents half the chord of the neighbours.
    vec3 k1 = c - a, k2 = 2.0 * a - 5.0 * b + 4.0 * c - d, k3 = 3.0 * (b - c) + d - a;
    world = b + 0.5 * u * (k1 + u * (k2 + u * k3));
    vec3 direction = k1 + u * (2.0 * k2 + u * 3.0 * k3);
    tangent = direction / max(length(direction), 1e-9);
    vec3 to_eye = eye - world;
    vec3 sideways = cross(tangent, to_eye);
    sideways /= max(length(sideways), 1e-9);
    float taper = 1.0 - 0.65 * along * along * along;
    // A ribbon thinner than the samples of the picture would break up into dots.
    float width = max(strand_width * taper, sample_angle * length(to_eye));
    world += sideways * (0.5 * width * across);
    variation = fract(sin(float(gl_InstanceID) * 12.9898) * 43758.5453);
    gl_Position = clip_from_world * vec4(world, 1.0);
}
