"""GLSL of the pictures: one program for hair, one for the body, one for the background, in linear light.

The hair's light follows Marschner et al. 2003 in its separable form: a Gaussian lobe along the strand (theta) times a
simple lobe around it (phi), for the uncoloured reflection R and the coloured one TRT, over a Kajiya-Kay diffuse term.
"""

# Positions of all strands lie in one texture, row after row; the vertex shader smooths and widens them.
# One instance is one strand, drawn as a triangle strip of two vertices per sample.
HAIR_VERTEX = """
#version 330
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
    // Thinner than the samples of the picture, a ribbon would fall apart into dots.
    float width = max(strand_width * taper, sample_angle * length(to_eye));
    world += sideways * (0.5 * width * across);
    variation = fract(sin(float(gl_InstanceID) * 12.9898) * 43758.5453);
    gl_Position = clip_from_world * vec4(world, 1.0);
}
"""

# Bare lines through the strands' vertices, one pixel wide: how the key light's maps see hair.
LINE_VERTEX = """
#version 330
uniform sampler2D points;
uniform int strand_vertices;
uniform mat4 clip_from_world;
void main() {
    int i = gl_VertexID + gl_InstanceID * strand_vertices;
    int width = textureSize(points, 0).x;
    gl_Position = clip_from_world * vec4(texelFetch(points, ivec2(i % width, i / width), 0).xyz, 1.0);
}
"""

LAYERS = """
// Ends of the layers of a deep opacity map, behind the first hair [m]; the last one has no end.
const vec3 layer_ends = vec3(0.006, 0.018, 0.045);
const float last_layer = 0.1;
"""

# Added up over all hair in a texel: optical thickness from the first hair to the end of each layer.
THICKNESS_FRAGMENT = (
    """
#version 330
uniform sampler2D first_hair;
uniform float key_depth_range;
uniform float thickness;
out vec4 up_to;
"""
    + LAYERS
    + """
void main() {
    float behind = gl_FragCoord.z - texelFetch(first_hair, ivec2(gl_FragCoord.xy), 0).x;
    up_to = thickness * vec4(step(vec3(behind * key_depth_range), layer_ends), 1.0);
}
"""
)

KEY_SHADOW = (
    """
uniform sampler2D body_depth;
uniform sampler2D first_hair;
uniform sampler2D hair_thickness;
uniform mat4 key_from_world;
uniform float key_depth_range;
uniform vec3 key_direction;
uniform vec3 eye;
"""
    + LAYERS
    + """
vec3 on_map(vec3 position) { return (key_from_world * vec4(position, 1.0)).xyz * 0.5 + 0.5; }

float thickness_at(vec4 up_to, float behind) {
    vec3 share = clamp((vec3(behind) - vec3(0.0, layer_ends.xy)) / (layer_ends - vec3(0.0, layer_ends.xy)), 0.0, 1.0);
    float deepest = clamp((behind - layer_ends.z) / (last_layer - layer_ends.z), 0.0, 1.0);
    return dot(share, up_to.xyz - vec3(0.0, up_to.xy)) + deepest * (up_to.w - up_to.z);
}

// Optical thickness of the hair between the light and a point within the hair.
float thickness_in_hair(vec3 position) {
    vec3 key = on_map(position);
    vec2 texel = 1.0 / vec2(textureSize(first_hair, 0));
    float total = 0.0;
    for (int y = -1; y <= 1; ++y)
        for (int x = -1; x <= 1; ++x) {
            vec2 at = key.xy + 1.5 * vec2(x, y) * texel;
            float behind = max(key.z - texture(first_hair, at).x, 0.0) * key_depth_range;
            total += thickness_at(textureLod(hair_thickness, at, 1.0), behind);
        }
    return total / 9.0;
}

// The same for all hair before a point on the body; the light is as wide as a window, so no strand shows singly.
float thickness_before_body(vec3 position, float blur) {
    vec2 at = on_map(position).xy;
    float lod = log2(max(blur / key_depth_range * float(textureSize(hair_thickness, 0).x), 1.0));
    float step = 0.5 * blur / key_depth_range;
    float total = 2.0 * textureLod(hair_thickness, at, lod).w;
    for (int i = 0; i < 8; ++i) {
        float angle = 0.785398 * float(i);
        vec2 aside = step * (1.0 + 0.6 * float(i % 2)) * vec2(cos(angle), sin(angle));
        total += textureLod(hair_thickness, at + aside, lod).w;
    }
    return total / 10.0;
}

// Share of the key light that the body lets by, soft at the edge of its shadow.
float body_lets_by(vec3 position, float bias, int taps) {
    vec3 key = on_map(position);
    float step = 0.0045 / key_depth_range / float(taps), light = 0.0;
    for (int y = -taps; y <= taps; ++y)
        for (int x = -taps; x <= taps; ++x) {
            float first = texture(body_depth, key.xy + step * vec2(x, y)).x;
            // Off the map, and beyond it, nothing is known to stand in the light.
            float behind = first < 1.0 ? (key.z - first) * key_depth_range : 0.0;
            light += 1.0 - smoothstep(bias, 2.0 * bias + 0.002, behind);
        }
    return light / float((2 * taps + 1) * (2 * taps + 1));
}

vec3 display(vec3 linear) {
    vec3 shown = clamp(linear, 0.0, 1.0);
    return mix(12.92 * shown, 1.055 * pow(shown, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, shown));
}
"""
)

HAIR_FRAGMENT = (
    """
#version 330
in vec3 world;
in vec3 tangent;
in float along;
in float across;
in float variation;
uniform vec3 hair_colour;
uniform vec3 fill_direction;
uniform vec3 rim_direction;
out vec4 colour;
"""
    + KEY_SHADOW
    + """
float lobe(float x, float width) { return exp(-0.5 * x * x / (width * width)); }

vec3 scattered(vec3 t, vec3 view, vec3 light, vec3 albedo) {
    float sin_in = dot(t, light), sin_out = dot(t, view);
    float half_theta = 0.5 * (asin(clamp(sin_in, -1.0, 1.0)) + asin(clamp(sin_out, -1.0, 1.0)));
    vec3 light_across = light - sin_in * t, view_across = view - sin_out * t;
    float cos_phi = dot(light_across, view_across) / max(length(light_across) * length(view_across), 1e-4);
    float facing = sqrt(0.5 + 0.5 * clamp(cos_phi, -1.0, 1.0));
    float shift = radians(6.0) + radians(4.0) * (variation - 0.5);
    // Cuticle scales tilt towards the root: R moves to one side of the mirror direction, TRT to the other.
    float r = lobe(half_theta + shift, radians(6.0)) * facing;
    float trt = lobe(half_theta - 1.5 * shift, radians(11.0)) * facing * facing;
    float diffuse = sqrt(max(1.0 - sin_in * sin_in, 0.0)) * (0.35 + 0.65 * facing);
    return 0.8 * albedo * diffuse + vec3(0.07) * r + 1.6 * albedo * trt;
}

void main() {
    vec3 t = normalize(tangent), view = normalize(eye - world);
    vec3 albedo = hair_colour * (0.6 + 0.8 * variation * variation) * mix(0.8, 1.1, along);
    float thickness = thickness_in_hair(world);
    float transmission = exp(-thickness) * body_lets_by(world, 0.004, 1);
    // Strands deep inside see little of the room either; roots sit deepest.
    float openness = mix(0.3, 1.0, exp(-0.4 * thickness)) * mix(0.55, 1.0, smoothstep(0.0, 0.3, along));
    vec3 light = 1.25 * transmission * scattered(t, view, key_direction, albedo);
    light += openness * vec3(0.29, 0.29, 0.30) * scattered(t, view, fill_direction, albedo);
    light += openness * 0.30 * scattered(t, view, rim_direction, albedo);
    light += openness * 0.10 * albedo;
    light *= 1.0 - 0.35 * across * across;
    colour = vec4(display(light), 1.0);
}
"""
)

BODY_VERTEX = """
#version 330
in vec3 position;
in vec3 normal;
in float scalp;
uniform mat4 clip_from_world;
out vec3 world;
out vec3 surface_normal;
out float hair_cover;
invariant gl_Position;
void main() {
    world = position;
    surface_normal = normal;
    hair_cover = scalp;
    gl_Position = clip_from_world * vec4(position, 1.0);
}
"""

BODY_FRAGMENT = (
    """
#version 330
in vec3 world;
in vec3 surface_normal;
in float hair_cover;
uniform vec3 body_colour;
uniform vec3 hair_colour;
uniform vec3 fill_direction;
uniform vec3 rim_direction;
out vec4 colour;
"""
    + KEY_SHADOW
    + """
// Red light goes further in skin and in hair: their shadows are warm.
const vec3 SKIN_SHADOW = vec3(0.75, 1.0, 1.15);

// Skin turns the corner softly: light wraps past the terminator.
float wrapped(vec3 n, vec3 light) { float w = 0.25; return max((dot(n, light) + w) / (1.0 + w), 0.0); }

void main() {
    vec3 n = normalize(surface_normal), view = normalize(eye - world);
    if (!gl_FrontFacing) n = -n;
    vec3 transmission = exp(-SKIN_SHADOW * thickness_before_body(world, 0.012));
    transmission *= body_lets_by(world + 0.006 * n, 0.003, 2);
    float sky = 0.5 + 0.5 * n.z;
    vec3 light = vec3(0.88, 0.85, 0.82) * wrapped(n, key_direction) * transmission;
    light += vec3(0.25, 0.25, 0.26) * wrapped(n, fill_direction);
    light += mix(vec3(0.11, 0.09, 0.08), vec3(0.23, 0.23, 0.235), sky);
    float grazing = pow(1.0 - max(dot(n, view), 0.0), 3.0);
    light += 0.35 * grazing * max(dot(n, rim_direction), 0.0);
    vec3 halfway = normalize(view + key_direction);
    float gloss = 0.06 * pow(max(dot(n, halfway), 0.0), 24.0) * transmission.g;
    // Between guide strands grow the hairs that they stand for: the scalp is hardly seen.
    vec3 albedo = mix(body_colour, 0.45 * hair_colour, 0.9 * hair_cover);
    colour = vec4(display(albedo * light + gloss * (1.0 - hair_cover)), 1.0);
}
"""
)

# Depth from the key light needs no colour.
DEPTH_FRAGMENT = """
#version 330
void main() {}
"""

BACKGROUND_VERTEX = """
#version 330
out vec2 screen;
void main() {
    screen = vec2(float(gl_VertexID % 2), float(gl_VertexID / 2)) * 2.0;
    gl_Position = vec4(screen * 2.0 - 1.0, 0.0, 1.0);
}
"""

BACKGROUND_FRAGMENT = """
#version 330
in vec2 screen;
out vec4 colour;
void main() {
    float fade = smoothstep(0.1, 0.85, length(screen - vec2(0.5, 0.55)));
    colour = vec4(mix(vec3(0.93, 0.935, 0.94), vec3(0.76, 0.775, 0.79), fade), 1.0);
}
"""
