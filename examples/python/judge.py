#!/usr/bin/env python3
"""A judge: prefers the policy while it keeps a distance and does not jump, else the expert.
It runs in place of the gate process, reads each step and publishes advice that expires.

    ./vlaps up --judge examples/python/judge.py --policy FILE.onnx
"""

from vlaps import process

CLEARANCE_M, STEER_JUMP = 1.0, 0.5


def judge(step):
    """Which of both proposals is safer."""
    if not step.policy.present:
        return process.Preference.ABSTAIN
    is_near = step.policy_assessment.clearance_m < CLEARANCE_M
    jumps = abs(step.policy.steer - step.observation.ego.steer) > STEER_JUMP
    if step.policy_assessment.veto or is_near or jumps:
        return process.Preference.EXPERT
    return process.Preference.POLICY


def main():
    run = process.Member("gate")
    steps, advices = run.reader("step"), run.writer("advice")
    hold_ns = int(run.setting("gate.hold_s") * 1e9)
    advice = process.Advice(judge=process.Judge.RULES)
    while run.wait():
        if (step := steps.newest()) is None:
            continue
        taken_ns = step.observation.header.taken_ns
        now_ns = step.header.taken_ns if run.is_lockstep else run.now_ns()
        advice.header, advice.question_tick = step.header, step.header.tick
        advice.question_taken_ns = advice.label_from_ns = taken_ns
        advice.answered_ns = advice.considered_ns = now_ns
        advice.holds_until_ns, advice.label_until_ns = taken_ns + hold_ns, taken_ns + 1
        advice.answers += 1
        advice.preference = advice.label = judge(step)
        advices.publish(advice)


process.run(main)
