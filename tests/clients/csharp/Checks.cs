// Checks ADDRESS MODEL TOKEN: what the example of the C# client does not show. Prints a line for each; a wrong one ends it.
using System;
using System.Collections.Generic;
using System.Text;
using System.Threading.Tasks;
using Pliant;
using V1 = Pliant.V1;

static class Checks
{
    const string Obj = "mtllib paint.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl red\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";

    static int Main(string[] words) => RunAsync(words[0], words[1], words[2]).GetAwaiter().GetResult();

    static void Expect(bool isRight, string what)
    {
        Console.WriteLine((isRight ? "right: " : "WRONG: ") + what);
        if (!isRight) Environment.Exit(1);
    }

    /// <summary>The status and words of a call that must fail.</summary>
    static async Task Refused(string what, StatusCode code, string words, Func<Task> call)
    {
        try
        {
            await call();
        }
        catch (PliantException problem)
        {
            Expect(problem.Code == code && problem.Message.Contains(words), $"{what}: {problem.Code} {problem.Message}");
            return;
        }
        Expect(false, what + " is not refused");
    }

    static async Task<int> RunAsync(string address, string model, string token)
    {
        var client = new Client(address, token);
        Expect((await client.LimitsAsync()).Window > 1, "limits");
        Expect((await client.SampleAsync()).Length > 100000, "the sample");
        var session = await client.OpenAsync(model);
        await session.SetHandlesAsync(
            Handles.HalfSpace("feet", new double[] { 0, -1, 0 }, -0.14), Handles.Sphere("head", new[] { 0.76, 1.22, 0 }, 0.36));
        Expect((await session.InfoAsync()).Model.Vertices == 8628, "info");

        var options = new V1.Options { Output = new V1.Output { Normals = true } };
        var solved = await session.SolveAsync(new[] { Handles.Moved("head", 0, 0.1, 0) }, options);
        Expect(solved.Normals.Length == solved.Positions.Length && solved.Positions.Length == 3 * 8628, "normals");
        Expect(solved.Quality != null && solved.IsFinal, "a recorded pose has a quality");

        var stream = await session.StreamAsync(options);
        var first = await stream.WaitAsync(await stream.SendAsync(new[] { Handles.Turned("head", 0, 0.1, 0) }));
        Expect(first.Normals.Length == first.Positions.Length, "normals on a stream");
        Expect(stream.Take() == first && stream.Take() == null, "a frame is taken once");
        await Refused("an unknown handle", StatusCode.InvalidArgument, "tail", () => stream.CommitAsync(new[] { Handles.Moved("tail", 0, 0.1, 0) }));
        var kept = await stream.CommitAsync(new[] { Handles.Turned("head", 0, 0.2, 0) });
        Expect(kept.Quality != null, "the stream goes on after a refusal");
        var packed = new V1.Options { Output = new V1.Output { Encoding = V1.Frame.Types.Encoding.U16 } };
        await Refused("a packed encoding", StatusCode.InvalidArgument, "F32", () => session.StreamAsync(packed));

        var other = client.Session(session.Id);
        var revision = (await other.InfoAsync()).Revision;
        Expect((await other.UndoAsync()).Revision != revision && (await other.RedoAsync()).Revision != revision, "undo and redo");
        await other.CloseAsync();
        await Refused("a stream of a deleted session", StatusCode.NotFound, "session", async () =>
        {
            while (true) await stream.WaitAsync(await stream.SendAsync(new[] { Handles.Turned("head", 0, 0.3, 0) }));
        });
        await Refused("a deleted session", StatusCode.NotFound, "session", () => session.InfoAsync());
        await Refused("a stream of no session", StatusCode.Unavailable, "none", () => client.Session("none").StreamAsync());

        var files = new Dictionary<string, byte[]> { ["paint.mtl"] = Encoding.ASCII.GetBytes("newmtl red\nKd 1 0 0\n") };
        var painted = await client.OpenAsync(Encoding.ASCII.GetBytes(Obj), new V1.CreateOptions { Format = "obj" }, files);
        Expect(Encoding.ASCII.GetString(await painted.ExportAsync("glb")).Contains("baseColorFactor"), "a companion's colour is in the export");
        await painted.CloseAsync();
        return 0;
    }
}
