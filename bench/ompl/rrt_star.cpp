// OMPL's RRTstar on the scenes of `./vlaps bench planner --ompl`; README.md describes
// the protocol.

#include <chrono>
#include <cstdio>
#include <iostream>
#include <memory>
#include <string>

#include <ompl/base/SpaceInformation.h>
#include <ompl/base/goals/GoalState.h>
#include <ompl/base/objectives/PathLengthOptimizationObjective.h>
#include <ompl/base/spaces/RealVectorStateSpace.h>
#include <ompl/base/terminationconditions/IterationTerminationCondition.h>
#include <ompl/datastructures/NearestNeighborsGNAT.h>
#include <ompl/datastructures/NearestNeighborsLinear.h>
#include <ompl/geometric/planners/rrt/RRTstar.h>
#include <ompl/util/Console.h>
#include <ompl/util/RandomNumbers.h>

#include "grid.hpp"

namespace ob = ompl::base;
namespace og = ompl::geometric;

namespace
{
    // The radius in which parents are chosen and edges rewired, m.
    double rewire_radius_m = 0.0;

    // RRTstar asks for neighbours within min(range, r_rrt * (log n / n)^(1/2)),
    // which no setting of its own makes a constant above its range. So the
    // structure answers with the paper's radius, whatever it is asked for.
    template <typename T>
    class Linear : public ompl::NearestNeighborsLinear<T>
    {
    public:
        void nearestR(const T &data, double, std::vector<T> &found) const override
        {
            ompl::NearestNeighborsLinear<T>::nearestR(data, rewire_radius_m, found);
        }
    };
    template <typename T>
    class Gnat : public ompl::NearestNeighborsGNAT<T>
    {
    public:
        void nearestR(const T &data, double, std::vector<T> &found) const override
        {
            ompl::NearestNeighborsGNAT<T>::nearestR(data, rewire_radius_m, found);
        }
    };

    Point point(const ob::State *state)
    {
        const double *values = state->as<ob::RealVectorStateSpace::StateType>()->values;
        return {values[0], values[1]};
    }

    class Validator : public ob::MotionValidator
    {
    public:
        Validator(const ob::SpaceInformationPtr &space, const Grid &grid) : MotionValidator(space), grid_(grid) {}

        bool checkMotion(const ob::State *from, const ob::State *to) const override
        {
            return grid_.isSegmentFree(point(from), point(to));
        }

        // The variant that returns how far the path is free; RRTstar never calls it.
        bool checkMotion(const ob::State *from, const ob::State *to, std::pair<ob::State *, double> &) const override
        {
            return checkMotion(from, to);
        }

    private:
        Grid grid_;
    };

    // Everything of a scene that all plans share.
    struct Problem
    {
        ob::SpaceInformationPtr space;

        Problem(const Layout &layout, const Scene &scene)
        {
            auto plane = std::make_shared<ob::RealVectorStateSpace>(2);
            ob::RealVectorBounds bounds(2);
            bounds.setLow(0, 0.0);
            bounds.setHigh(0, scene.x_max_m);
            bounds.setLow(1, scene.right_m);
            bounds.setHigh(1, scene.left_m);
            plane->setBounds(bounds);
            space = std::make_shared<ob::SpaceInformation>(plane);
            const Grid grid(layout, scene);
            space->setStateValidityChecker([grid](const ob::State *state) { return grid.isFree(point(state)); });
            space->setMotionValidator(std::make_shared<Validator>(space, grid));
            space->setup();
        }
    };

    struct Answer
    {
        long long time_ns;
        double cost_m;
        int solved;
        unsigned iterations;
    };

    Answer plan(const Layout &layout, const Scene &scene, const Problem &problem, unsigned iterations, bool linear)
    {
        const ob::SpaceInformationPtr &space = problem.space;
        auto task = std::make_shared<ob::ProblemDefinition>(space);
        ob::ScopedState<ob::RealVectorStateSpace> start(space), goal(space);
        start[0] = start[1] = 0.0;
        goal[0] = scene.goal.x;
        goal[1] = scene.goal.y;
        task->setStartAndGoalStates(start, goal, layout.goal_radius_m);
        task->setOptimizationObjective(std::make_shared<ob::PathLengthOptimizationObjective>(space));
        og::RRTstar planner(space);
        planner.setProblemDefinition(task);
        planner.setRange(layout.step_m);
        planner.setGoalBias(0.0);
        planner.setKNearest(false);
        if (linear)
            planner.setNearestNeighbors<Linear>();
        else
            planner.setNearestNeighbors<Gnat>();
        planner.setup();
        ob::IterationTerminationCondition limit(iterations);
        const ob::PlannerTerminationCondition stop = limit;
        // Only the search is timed, not its setup and cleanup.
        const auto begun = std::chrono::steady_clock::now();
        const ob::PlannerStatus status = planner.solve(stop);
        const auto time = std::chrono::steady_clock::now() - begun;
        const bool solved = status == ob::PlannerStatus::EXACT_SOLUTION;
        return {std::chrono::duration_cast<std::chrono::nanoseconds>(time).count(),
                solved ? task->getSolutionPath()->length() : 0.0, solved, planner.numIterations()};
    }
}

int main(int count, char **words)
try
{
    if (count != 3)
        throw std::runtime_error("usage: rrt_star SCENES gnat|linear");
    ompl::msg::setLogLevel(ompl::msg::LOG_ERROR);
    ompl::RNG::setSeed(1);
    Layout layout;
    const std::vector<Scene> scenes = readScenes(words[1], layout);
    const bool linear = std::string(words[2]) == "linear";
    rewire_radius_m = layout.rewire_radius_m;
    std::vector<Problem> problems;
    for (const Scene &scene : scenes)
        problems.emplace_back(layout, scene);
    std::printf("ready %zu\n", scenes.size());
    std::fflush(stdout);
    // The answers to a block of questions, which ends with an empty line, are written
    // together, so that no process waits for a pipe during a measurement.
    std::vector<Answer> answers;
    for (std::string line; std::getline(std::cin, line);)
    {
        std::size_t scene;
        unsigned iterations;
        if (std::sscanf(line.c_str(), "%zu %u", &scene, &iterations) == 2)
        {
            answers.push_back(plan(layout, scenes.at(scene), problems.at(scene), iterations, linear));
            continue;
        }
        for (const Answer &answer : answers)
            std::printf("%lld %.17g %d %u\n", answer.time_ns, answer.cost_m, answer.solved, answer.iterations);
        std::fflush(stdout);
        answers.clear();
    }
    return 0;
}
catch (const std::exception &error)
{
    std::fprintf(stderr, "rrt_star: %s\n", error.what());
    return 1;
}
