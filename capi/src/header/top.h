/* libvlaps: a process of a VLAPS run in C.
 *
 * Generated from the messages of the crate shm-config; do not edit. Renew it with
 *     cargo run -p capi --example header > capi/include/vlaps.h
 *
 * docs/foreign.md explains the calls, docs/services.md the services. Units end a name
 * and frames begin it: speed_mps, x_body_m. Angles are counter-clockwise, y is left.
 *
 * Every call returns 0 or more (enum vlaps_answer) when it was carried out, and a
 * negative number (enum vlaps_kind) when it failed; vlaps_last_error says why. All calls
 * of a process come from the thread that joined.
 */
#ifndef VLAPS_H
#define VLAPS_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
#define VLAPS_ASSERT(holds, text) static_assert(holds, text)
extern "C" {
#else
#define VLAPS_ASSERT(holds, text) _Static_assert(holds, text)
#endif

/* The hash of all layouts, codes and constants below. A library with another one refuses to join. */
