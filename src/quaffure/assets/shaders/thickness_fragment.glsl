#version 330
// Optical thickness from the first hair to the end of each layer; blending sums it over all hair in a texel.
uniform sampler2D first_hair;
uniform float key_depth_range;
uniform float thickness;
out vec4 up_to;

#include "opacity_layers.glsl"

void main() {
    float behind = gl_FragCoord.z - texelFetch(first_hair, ivec2(gl_FragCoord.xy), 0).x;
    up_to = thickness * vec4(step(vec3(behind * key_depth_range), layer_ends), 1.0);
}
