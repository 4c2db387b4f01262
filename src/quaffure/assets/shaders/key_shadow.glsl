uniform sampler2D body_depth;
uniform sampler2D first_hair;
uniform sampler2D hair_thickness;
uniform mat4 key_from_world;
uniform float key_depth_range;
uniform vec3 key_direction;
uniform vec3 eye;

#include "opacity_layers.glsl"

vec3 on_map(vec3 position) { return (key_from_world * vec4(position, 1.0)).xyz * 0.5 + 0.5; }

float thickness_at(vec4 up_to, float behind) {
    vec3 share = clamp((vec3(behind) - vec3(0.0, layer_ends.xy)) / (layer_ends - vec3(0.0, layer_ends.xy)), 0.0, 1.0);
    float deepest = clamp((behind - layer_ends.z) / (last_layer - layer_ends.z), 0.0, 1.0);
    return dot(share, up_to.xyz - vec3(0.0, up_to.xy)) + deepest * (up_to.w - up_to.z);
}

// Optical thickness of the hair between the light and a point inside the hair.
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

// The same for all hair in front of a point on the body. The light is as wide as a window: no single strand shows.
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

// Share of the key light that the body does not block, soft at the edge of its shadow.
float body_visibility(vec3 position, float bias, int taps) {
    vec3 key = on_map(position);
    float step = 0.0045 / key_depth_range / float(taps), light = 0.0;
    for (int y = -taps; y <= taps; ++y)
        for (int x = -taps; x <= taps; ++x) {
            float first = texture(body_depth, key.xy + step * vec2(x, y)).x;
            // Outside of the map nothing is known to block the light.
            float behind = first < 1.0 ? (key.z - first) * key_depth_range : 0.0;
            light += 1.0 - smoothstep(bias, 2.0 * bias + 0.002, behind);
        }
    return light / float((2 * taps + 1) * (2 * taps + 1));
}

vec3 display(vec3 linear) {
    vec3 shown = clamp(linear, 0.0, 1.0);
    return mix(12.92 * shown, 1.055 * pow(shown, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, shown));
}
