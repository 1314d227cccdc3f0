// A judge: prefers the policy while it keeps a distance and does not jump, else the expert.
// It runs in place of the gate process, reads each step and publishes advice that expires.
//
//     make -C examples/cpp judge
//     ./vlaps up --judge target/examples/judge --policy FILE.onnx
#include <cmath>

#include "vlaps.hpp"

constexpr double CLEARANCE_M = 1.0, STEER_JUMP = 0.5;

// Which of both proposals is safer: enum vlaps_preference.
uint32_t judge(const vlaps_step &step) {
    if (!step.policy.present) return VLAPS_PREFERENCE_ABSTAIN;
    const bool is_near = step.policy_assessment.clearance_m < CLEARANCE_M;
    const bool jumps = std::abs(step.policy.steer - step.observation.ego.steer) > STEER_JUMP;
    if (step.policy_assessment.veto || is_near || jumps) return VLAPS_PREFERENCE_EXPERT;
    return VLAPS_PREFERENCE_POLICY;
}

int main(int argc, char **argv) {
    return vlaps::run("judge", [&] {
        vlaps::member run("gate", argc, argv);
        vlaps::reader<vlaps_step> steps("step");
        vlaps::writer<vlaps_advice> advices("advice");
        const uint64_t hold_ns = static_cast<uint64_t>(run.setting("gate.hold_s") * 1e9);
        vlaps_step step{};
        vlaps_advice advice{};
        while (run.wait()) {
            if (!steps.newest(step)) continue;
            const uint64_t taken_ns = step.observation.header.taken_ns;
            const uint64_t now_ns = run.is_lockstep() ? step.header.taken_ns : run.now_ns();
            advice.header = step.header;
            advice.question_tick = step.header.tick;
            advice.question_taken_ns = advice.label_from_ns = taken_ns;
            advice.answered_ns = advice.considered_ns = now_ns;
            advice.holds_until_ns = taken_ns + hold_ns;
            advice.label_until_ns = taken_ns + 1;
            advice.answers++;
            advice.judge = VLAPS_JUDGE_RULES;
            advice.preference = advice.label = judge(step);
            advices.publish(advice);
        }
    });
}
